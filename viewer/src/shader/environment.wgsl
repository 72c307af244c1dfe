// From the depths of a face of an environment map to what splats are drawn by.

// Blocks along a side of a face.
const BLOCKS = 16u;

struct Block {
    // Pixels that show something, and the least and the greatest of their codes.
    points: u32,
    least: u32,
    most: u32,
}

@group(0) @binding(0) var depths: texture_depth_2d;
@group(0) @binding(1) var codes: texture_2d<u32>;
@group(0) @binding(2) var<storage, read_write> blocks: array<Block>;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

// Depths are near/distance: steps of 1/65535 are equal steps of parallax. 0 where nothing is.
@fragment
fn encode(@builtin(position) position: vec4f) -> @location(0) u32 {
    let depth = textureLoad(depths, vec2i(position.xy), 0);
    return select(0u, clamp(u32(depth * 65535.0 + 0.5), 1u, 65535u), depth > 0.0);
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
