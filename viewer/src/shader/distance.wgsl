// Metres along the view from a depth, near/depth; infinite where nothing is. Of several samples the nearest.

@group(1) @binding(0) var depths: DEPTHS;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) f32 {
    let pixel = vec2i(position.xy);
    var depth = 0.0;
    for (var i = 0; i < COUNT; i++) {
        depth = max(depth, textureLoad(depths, pixel, i));
    }
    // 3.4e38: as near to infinity as arithmetic that may assume finite numbers gets.
    return select(3.4e38, frame.forward.w / depth, depth > 0.0);
}
