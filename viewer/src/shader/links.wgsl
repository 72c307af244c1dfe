// [HIBR] §5.1 without the sphericality test, from what the textures hold: the pixel's eight neighbours are tested, links
// are closed in the four blocks of 2 × 2 around it, and more than four links make it connected.

// τ₁ in pixels and τ₂, as orthoviews are built with.
const DEPTH_APART = 4.0;
const NORMAL_APART = 0.7;

// The 3 × 3 pixels around one, row by row upwards.
struct Around {
    is_present: array<bool, 9>,
    steps: array<f32, 9>,
    positions: array<vec3f, 9>,
    normals: array<vec3f, 9>,
}

fn is_related(around: ptr<function, Around>, a: u32, b: u32) -> bool {
    if !((*around).is_present[a] && (*around).is_present[b]) {
        return false;
    }
    if abs((*around).steps[a] - (*around).steps[b]) * item.right.w >= DEPTH_APART * item.origin.w {
        return false;
    }
    let between = normalize((*around).positions[b] - (*around).positions[a]);
    return abs(dot((*around).normals[a], between)) < NORMAL_APART
        && abs(dot((*around).normals[b], between)) < NORMAL_APART;
}

fn is_connected(pixel: vec2u, shape: u32) -> bool {
    var around: Around;
    for (var i = 0u; i < 9u; i++) {
        let at = vec2i(pixel) + vec2i(i32(i % 3u), i32(i / 3u)) - 1;
        if any(at < vec2i(0)) || any(at >= vec2i(item.size.xy)) {
            around.is_present[i] = false;
            continue;
        }
        let there = textureLoad(shapes, at, 0).x;
        around.is_present[i] = (there & PRESENT) != 0u;
        around.steps[i] = f32(there & DEPTH);
        // Relative to the pixel in the middle, so that digits are not lost.
        let step = vec2f(vec2i(i32(i % 3u), i32(i / 3u)) - 1) * item.origin.w;
        around.positions[i] = item.right.xyz * step.x + item.up.xyz * step.y
            - item.towards_eye.xyz * ((f32(there & DEPTH) - f32(shape & DEPTH)) * item.right.w);
        around.normals[i] = normal_at(vec2u(at));
    }
    // Links of the middle, 4, to the others.
    var links = 0u;
    for (var block = 0u; block < 4u; block++) {
        let first = (block >> 1u) * 3u + (block & 1u);
        var places = array<u32, 4>(first, first + 1u, first + 3u, first + 4u);
        // Groups of the block's pixels, joined pair by pair: the lower number stands for both.
        var group = array<u32, 4>(0u, 1u, 2u, 3u);
        for (var i = 0u; i < 3u; i++) {
            for (var j = i + 1u; j < 4u; j++) {
                if is_related(&around, places[i], places[j]) {
                    let low = min(group[i], group[j]);
                    let high = max(group[i], group[j]);
                    for (var k = 0u; k < 4u; k++) {
                        if group[k] == high {
                            group[k] = low;
                        }
                    }
                }
            }
        }
        // The middle is the block's corner that is left when the block is.
        let middle = 3u - block;
        for (var k = 0u; k < 4u; k++) {
            if k != middle && group[k] == group[middle] {
                links |= 1u << places[k];
            }
        }
    }
    return countOneBits(links) > 4u;
}
