// Which tiles may be seen: a tile is hidden if, wherever its box is in the picture, something nearer than the box's nearest
// point has been drawn.

struct View {
    clip_from_relative: mat4x4f,
    // Columns, rows, levels of the pyramid, tiles.
    size: vec4u,
    // x: the near plane, metres.
    near: vec4f,
}

struct Tile {
    // Corners of the box, relative to the eye, metres; w of the first: its first draw, of the second: how many.
    low: vec3f,
    first: u32,
    high: vec3f,
    draws: u32,
}

struct Draw {
    indices: u32,
    instances: u32,
    first_index: u32,
    base_vertex: i32,
    first_instance: u32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
@group(0) @binding(2) var<storage, read_write> draws: array<Draw>;
@group(0) @binding(3) var<storage, read_write> seen: array<u32>;
@group(0) @binding(4) var pyramid: texture_2d<f32>;

fn may_be_seen(tile: Tile) -> bool {
    var low = vec2f(1e30);
    var high = vec2f(-1e30);
    var distance = 1e30;
    for (var corner = 0u; corner < 8u; corner++) {
        let at = select(tile.low, tile.high, vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u));
        let clip = view.clip_from_relative * vec4f(at, 1.0);
        // It reaches behind the camera: anything is possible.
        if clip.w <= view.near.x {
            return true;
        }
        let place = clip.xy / clip.w;
        low = min(low, place);
        high = max(high, place);
        distance = min(distance, clip.w);
    }
    // In pixels, rows from the top; one more on each side for what rounding moves.
    let size = vec2f(view.size.xy);
    let least = (vec2f(low.x, -high.y) * 0.5 + 0.5) * size - 1.0;
    let most = (vec2f(high.x, -low.y) * 0.5 + 0.5) * size + 1.0;
    if any(most < vec2f(0.0)) || any(least > size) {
        return false;
    }
    let first = vec2u(clamp(least, vec2f(0.0), size - 1.0));
    let last = vec2u(clamp(most, vec2f(0.0), size - 1.0));
    // At most five texels a side.
    let span = last - first;
    var level = 0u;
    while level + 1u < view.size.z && any((span >> vec2u(level + 1u)) > vec2u(3u)) {
        level++;
    }
    let from_texel = first >> vec2u(level + 1u);
    let to_texel = last >> vec2u(level + 1u);
    var farthest = 1.0;
    for (var y = from_texel.y; y <= to_texel.y; y++) {
        for (var x = from_texel.x; x <= to_texel.x; x++) {
            farthest = min(farthest, textureLoad(pyramid, vec2u(x, y), level).x);
        }
    }
    return view.near.x / distance * 1.00001 >= farthest;
}

@compute @workgroup_size(64)
fn test_tiles(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= view.size.w {
        return;
    }
    let tile = tiles[id.x];
    let is_seen = may_be_seen(tile);
    seen[id.x] = u32(is_seen);
    if !is_seen {
        for (var i = 0u; i < tile.draws; i++) {
            draws[tile.first + i].instances = 0u;
        }
    }
}
