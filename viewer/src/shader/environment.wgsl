// From the scratch image of a face of an environment map to the list of its points: codes of depth, counts, and the list.

// Blocks along a side of a face.
const BLOCKS = 16u;
// Pixels of the base's face that a pixel has to cover to be left out: there, samples are nearly as dense.
const DENSE = 0.8;

// What the map that is made has to do with its base, the map that leaves it what it shows as well.
struct Face {
    // Axes of the face in the world; w: metres at the largest code.
    right: vec4f,
    up: vec4f,
    forward: vec4f,
    // From the base to the map, metres; w: 1 if there is a base.
    moved: vec4f,
}

struct Block {
    // Pixels that show something, and the least and the greatest of their codes.
    points: u32,
    least: u32,
    most: u32,
}

@group(0) @binding(0) var depths: texture_depth_2d;
@group(0) @binding(1) var codes: texture_2d<u32>;
@group(0) @binding(2) var<storage, read_write> blocks: array<Block>;
@group(0) @binding(3) var<uniform> face: Face;
// Faces of the base: along x, against x, and so on.
@group(0) @binding(4) var base: texture_2d_array<u32>;
@group(0) @binding(5) var colours: texture_2d<f32>;
// Where a block's points begin.
@group(0) @binding(6) var<storage, read> starts: array<u32>;
@group(0) @binding(7) var list: texture_storage_2d<rg32uint, write>;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

// Where the base shows a point: its pixel, its face, and its distance along that face's axis.
struct Seen {
    pixel: vec2f,
    layer: i32,
    distance: f32,
}

fn seen(at: vec3f, side: f32) -> Seen {
    var seen: Seen;
    let size = abs(at);
    var place: vec2f;
    if size.x >= size.y && size.x >= size.z {
        seen.layer = select(1, 0, at.x > 0.0);
        seen.distance = size.x;
        place = vec2f(select(at.y, -at.y, at.x > 0.0), at.z);
    } else if size.y >= size.z {
        seen.layer = select(3, 2, at.y > 0.0);
        seen.distance = size.y;
        place = vec2f(select(-at.x, at.x, at.y > 0.0), at.z);
    } else {
        seen.layer = select(5, 4, at.z > 0.0);
        seen.distance = size.z;
        place = vec2f(select(at.x, -at.x, at.z > 0.0), at.y);
    }
    seen.pixel = (vec2f(place.x, -place.y) / max(seen.distance, 1e-30) * 0.5 + 0.5) * side;
    return seen;
}

// Whether the base shows the same surface there: between its four nearest pixels codes of a plane are bilinear.
fn is_shown(there: Seen, side: f32, near: f32) -> bool {
    if there.distance < near {
        return false;
    }
    let corner = clamp(floor(there.pixel - 0.5), vec2f(0.0), vec2f(side - 2.0));
    let share = clamp(there.pixel - 0.5 - corner, vec2f(0.0), vec2f(1.0));
    var code = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let step = vec2u(i & 1u, i >> 1u);
        let one = textureLoad(base, vec2u(corner) + step, there.layer, 0).x;
        if one == 0u {
            return false;
        }
        let weights = select(1.0 - share, share, step == vec2u(1u));
        code += f32(one) * weights.x * weights.y;
    }
    // Two steps, and two pixels' width in depth: by so much do discs of one surface differ.
    let expected = near / there.distance * 65535.0;
    return abs(code - expected) <= 2.0 + expected * 4.0 / side;
}

// Depths are near/distance: steps of 1/65535 are equal steps of parallax. 0 where nothing is, or the base shows it.
@fragment
fn encode(@builtin(position) position: vec4f) -> @location(0) u32 {
    let side = f32(textureDimensions(depths).x);
    let depth = textureLoad(depths, vec2i(position.xy), 0);
    let tangent = position.xy * (2.0 / side) - 1.0;
    let ray = face.forward.xyz + face.right.xyz * tangent.x - face.up.xyz * tangent.y;
    let near = face.forward.w;
    let there = seen(face.moved.xyz + ray * (near / max(depth, 1e-30)), side);
    let across = dpdx(there.pixel);
    let down = dpdy(there.pixel);
    if depth <= 0.0 {
        return 0u;
    }
    let is_dense = abs(across.x * down.y - across.y * down.x) >= DENSE;
    if face.moved.w > 0.0 && is_dense && is_shown(there, side, near) {
        return 0u;
    }
    return clamp(u32(depth * 65535.0 + 0.5), 1u, 65535u);
}

var<workgroup> points: atomic<u32>;
var<workgroup> least: atomic<u32>;
var<workgroup> most: atomic<u32>;

@compute @workgroup_size(64)
fn count(@builtin(workgroup_id) block: vec3u, @builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        atomicStore(&least, 65535u);
    }
    workgroupBarrier();
    let side = textureDimensions(codes).x / BLOCKS;
    for (var i = lane; i < side * side; i += 64u) {
        let code = textureLoad(codes, block.xy * side + vec2u(i % side, i / side), 0).x;
        if code != 0u {
            atomicAdd(&points, 1u);
            atomicMin(&least, code);
            atomicMax(&most, code);
        }
    }
    workgroupBarrier();
    if lane == 0u {
        blocks[block.y * BLOCKS + block.x] = Block(atomicLoad(&points), atomicLoad(&least), atomicLoad(&most));
    }
}

fn byte(light: f32) -> u32 {
    let curve = select(1.055 * pow(light, 1.0 / 2.4) - 0.055, 12.92 * light, light <= 0.0031308);
    return u32(clamp(curve, 0.0, 1.0) * 255.0 + 0.5);
}

var<workgroup> begins: array<u32, 64>;

// A block's points in the order of its pixels: each lane has a run of them. An entry: 12 bits of column, 12 of row, 8 of
// red; 16 of code, 8 of green, 8 of blue, sRGB.
@compute @workgroup_size(64)
fn fill(@builtin(workgroup_id) block: vec3u, @builtin(local_invocation_index) lane: u32) {
    let side = textureDimensions(codes).x / BLOCKS;
    let run = (side * side + 63u) / 64u;
    let end = min((lane + 1u) * run, side * side);
    var own = 0u;
    for (var i = lane * run; i < end; i++) {
        own += u32(textureLoad(codes, block.xy * side + vec2u(i % side, i / side), 0).x != 0u);
    }
    begins[lane] = own;
    workgroupBarrier();
    if lane == 0u {
        var sum = starts[block.y * BLOCKS + block.x];
        for (var i = 0u; i < 64u; i++) {
            let here = begins[i];
            begins[i] = sum;
            sum += here;
        }
    }
    workgroupBarrier();
    var to = begins[lane];
    let columns = textureDimensions(list).x;
    for (var i = lane * run; i < end; i++) {
        let pixel = block.xy * side + vec2u(i % side, i / side);
        let code = textureLoad(codes, pixel, 0).x;
        if code != 0u {
            let light = textureLoad(colours, pixel, 0).xyz;
            let entry = vec2u(pixel.x | (pixel.y << 12u) | (byte(light.x) << 24u),
                code | (byte(light.y) << 16u) | (byte(light.z) << 24u));
            textureStore(list, vec2u(to % columns, to / columns), vec4u(entry, 0u, 0u));
            to++;
        }
    }
}
