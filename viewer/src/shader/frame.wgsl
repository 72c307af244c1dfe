// What all shaders of a frame know. Positions and directions are in world axes; positions are relative to the eye, metres.

struct Frame {
    clip_from_relative: mat4x4f,
    // w: half the picture's width at distance 1.
    right: vec4f,
    // w: half the picture's height at distance 1.
    up: vec4f,
    // w: the near plane, metres.
    forward: vec4f,
    // Towards the sun, unit; w: the share of light that comes from everywhere, 1 where nothing is lit.
    sun: vec4f,
    // Linear light.
    zenith: vec4f,
    horizon: vec4f,
    ground: vec4f,
    // Upwards in the world.
    world_up: vec4f,
    // Columns, rows; shape of splats; 1 if the target keeps what it is given, so that sRGB is to be written.
    size: vec4u,
}

@group(0) @binding(0) var<uniform> frame: Frame;

// IEC 61966-2-1.
fn srgb(light: vec3f) -> vec3f {
    let clamped = clamp(light, vec3f(0.0), vec3f(1.0));
    let curve = 1.055 * pow(clamped, vec3f(1.0 / 2.4)) - 0.055;
    return select(curve, 12.92 * clamped, clamped <= vec3f(0.0031308));
}

fn from_srgb(colour: vec3f) -> vec3f {
    return select(pow((colour + 0.055) / 1.055, vec3f(2.4)), colour / 12.92, colour <= vec3f(0.04045));
}

// What the target is given for linear light.
fn written(light: vec3f) -> vec4f {
    return vec4f(select(light, srgb(light), frame.size.w == 1u), 1.0);
}
