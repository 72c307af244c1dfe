// Triangles with a texture a part.

struct Part {
    // Linear light; w: what is less opaque is a hole.
    base: vec4f,
}

@group(2) @binding(0) var<uniform> part: Part;
@group(2) @binding(1) var texels: texture_2d<f32>;
@group(2) @binding(2) var filtered: sampler;

struct Corner {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) tint: vec4f,
}

struct Surface {
    @builtin(position) position: vec4f,
    @location(0) normal: vec3f,
    @location(1) uv: vec2f,
    @location(2) tint: vec3f,
    @location(3) at: vec3f,
}

fn from_srgb(colour: vec3f) -> vec3f {
    return select(pow((colour + 0.055) / 1.055, vec3f(2.4)), colour / 12.92, colour <= vec3f(0.04045));
}

@vertex
fn vertex(corner: Corner) -> Surface {
    var surface: Surface;
    surface.at = item.origin.xyz + corner.position;
    surface.position = frame.clip_from_relative * vec4f(surface.at, 1.0);
    surface.normal = corner.normal;
    surface.uv = corner.uv;
    surface.tint = from_srgb(corner.tint.xyz);
    return surface;
}

@fragment
fn fragment(surface: Surface, @builtin(front_facing) is_front: bool) -> @location(0) vec4f {
    let texel = textureSample(texels, filtered, surface.uv);
    if texel.w < part.base.w {
        discard;
    }
    if item.counts.x != 0u && is_hidden(surface.at) {
        discard;
    }
    let length = max(length(surface.normal), 1e-6);
    let normal = select(-surface.normal, surface.normal, is_front) / length;
    return written(shaded(surface.tint * part.base.xyz * texel.xyz, normal));
}
