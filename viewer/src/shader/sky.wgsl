// What is seen where nothing is: one triangle over the picture, infinitely far away.

struct Sky {
    @builtin(position) position: vec4f,
    @location(0) ray: vec3f,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Sky {
    var sky: Sky;
    let at = vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0;
    sky.position = vec4f(at, 0.0, 1.0);
    sky.ray = frame.forward.xyz + frame.right.xyz * (at.x * frame.right.w) + frame.up.xyz * (at.y * frame.up.w);
    return sky;
}

@fragment
fn fragment(sky: Sky) -> @location(0) vec4f {
    let height = dot(normalize(sky.ray), frame.world_up.xyz);
    let above = mix(frame.horizon.xyz, frame.zenith.xyz, sqrt(clamp(height, 0.0, 1.0)));
    let below = mix(frame.horizon.xyz, frame.ground.xyz, clamp(-8.0 * height, 0.0, 1.0));
    return written(select(below, above, height >= 0.0));
}
