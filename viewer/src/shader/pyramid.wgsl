// The farthest of what was drawn, in ever larger squares: depths are near/distance, so the least. A texel of level k covers
// 2^(k+1) pixels a side. Beyond the picture stands 1, which hides nothing that is in it.

@group(0) @binding(0) var finer: FINER;
@group(0) @binding(1) var coarser: texture_storage_2d<r32float, write>;

@compute @workgroup_size(8, 8)
fn reduce(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= textureDimensions(coarser)) {
        return;
    }
    let size = textureDimensions(finer);
    var farthest = 1.0;
    for (var corner = 0u; corner < 4u; corner++) {
        let at = 2u * id.xy + vec2u(corner & 1u, corner >> 1u);
        if all(at < size) {
            for (var i = 0; i < COUNT; i++) {
                farthest = min(farthest, LOAD);
            }
        }
    }
    textureStore(coarser, id.xy, vec4f(farthest));
}
