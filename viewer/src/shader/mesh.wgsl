// Triangles with a texture a part.

struct Part {
    // Linear light; w: what is less opaque is a hole.
    base: vec4f,
}

@group(2) @binding(0) var<uniform> part: Part;
@group(2) @binding(1) var texels: texture_2d<f32>;
@group(2) @binding(2) var filtered: sampler;

// Samples a pixel, 1 or 4.
override SAMPLES: u32 = 1u;

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
    // Before anything is discarded: they need the pixel's neighbours.
    let texel = textureSample(texels, filtered, surface.uv);
    let steepness = fwidth(texel.w);
    let face = cross(dpdx(surface.at), dpdy(surface.at));
    if item.counts.x != 0u && is_hidden(surface.at) {
        discard;
    }
    var cover = 1.0;
    if part.base.w > 0.0 {
        // The edge of a hole over a pixel: opacity as a share of the samples, or all or nothing.
        cover = clamp((texel.w - part.base.w) / max(steepness, 1e-4) + 0.5, 0.0, 1.0);
        if (SAMPLES == 1u && texel.w < part.base.w) || cover <= 0.0 {
            discard;
        }
    }
    // Where the file has no normals, that of the face, towards the eye.
    var normal = surface.normal;
    if dot(normal, normal) < 0.25 {
        normal = face * -sign(dot(face, surface.at));
    } else if !is_front {
        normal = -normal;
    }
    normal = normal / max(length(normal), 1e-12);
    let light = written(shaded(surface.tint * part.base.xyz * texel.xyz, normal));
    return vec4f(light.xyz, select(cover, 1.0, SAMPLES == 1u));
}
