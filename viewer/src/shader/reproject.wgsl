// The frame before, seen from here, fades into this one. [HIBR] §5.3.

struct Change {
    // Of the frame before: from relative to its eye to its clip space.
    clip_before: mat4x4f,
    // This frame's axes; w: half the picture's width and height at distance 1.
    right: vec4f,
    up: vec4f,
    // w: what the frame before counts for.
    forward: vec4f,
    // From the eye before to the eye, metres; w: share of a distance by which two may differ and be the same surface.
    moved: vec4f,
}

@group(0) @binding(0) var<uniform> change: Change;
@group(0) @binding(1) var colours: texture_2d<f32>;
@group(0) @binding(2) var distances: texture_2d<f32>;
@group(0) @binding(3) var colours_before: texture_2d<f32>;
@group(0) @binding(4) var distances_before: texture_2d<f32>;

struct Faded {
    @location(0) target_: vec4f,
    @location(1) kept: vec4f,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

// The colour there was at a point, and whether it was seen at all: of the four nearest pixels those that are of the same
// surface, if they make up half of it.
fn before(at: vec3f) -> vec4f {
    let clip = change.clip_before * vec4f(at, 1.0);
    if clip.w <= 0.0 {
        return vec4f(0.0);
    }
    let size = vec2f(textureDimensions(colours_before));
    let place = (vec2f(clip.x, -clip.y) / clip.w * 0.5 + 0.5) * size - 0.5;
    let corner = floor(place);
    let share = place - corner;
    var sum = vec4f(0.0);
    for (var i = 0u; i < 4u; i++) {
        let step = vec2f(f32(i & 1u), f32(i >> 1u));
        let pixel = corner + step;
        if any(pixel < vec2f(0.0)) || any(pixel >= size) {
            continue;
        }
        let distance = textureLoad(distances_before, vec2u(pixel), 0).x;
        if abs(distance - clip.w) > change.moved.w * clip.w {
            continue;
        }
        let weights = select(1.0 - share, share, step > vec2f(0.5));
        sum += vec4f(textureLoad(colours_before, vec2u(pixel), 0).xyz, 1.0) * (weights.x * weights.y);
    }
    if sum.w < 0.5 {
        return vec4f(0.0);
    }
    return vec4f(sum.xyz / sum.w, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> Faded {
    let pixel = vec2u(position.xy);
    let now = textureLoad(colours, pixel, 0).xyz;
    let distance = textureLoad(distances, pixel, 0).x;
    var colour = now;
    if change.forward.w > 0.0 && distance < 1e30 {
        let place = position.xy / vec2f(textureDimensions(colours)) * 2.0 - 1.0;
        let ray = change.forward.xyz + change.right.xyz * (place.x * change.right.w) - change.up.xyz * (place.y * change.up.w);
        let old = before(ray * distance + change.moved.xyz);
        // What half floats keep is rounded at each frame: differences of that size are not carried on.
        if any(abs(old.xyz - now) > now / 512.0) {
            colour = mix(now, old.xyz, old.w * change.forward.w);
        }
    }
    return Faded(vec4f(colour, 1.0), vec4f(colour, 1.0));
}
