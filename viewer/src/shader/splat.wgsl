// Orthoviews: a quad a pixel, of which a disc is kept. [HIBR] §5.2, in three dimensions instead of on the screen: the
// quad is spanned by the disc's own axes, so that the rasteriser does the projection exactly. Faces of environment maps
// too: their samples are lit already, lie along rays instead of parallels, and are circles that face the camera.

@group(2) @binding(0) var colours: texture_2d<f32>;
@group(2) @binding(1) var shapes: texture_2d<u32>;
@group(2) @binding(2) var normals: texture_2d<f32>;

// Samples a pixel, 1 or 4.
override SAMPLES: u32 = 1u;

const CIRCULAR = 0u;
const WARPED = 1u;
const ELLIPTICAL = 2u;
const HYBRID_NO_SPHERICALITY = 3u;

const DEPTH = 0x3ffu;
const CONNECTED = 0x4000u;
const PRESENT = 0x8000u;

// Slope of a disc against the image's plane at most: neighbours that differ by more are not connected (τ₁), and the axes
// of what stands upright would be infinitely long.
const SLOPE_MAX = 4.0;

// Pixels that a disc falls back at one pixel from its middle.
const BULGE = 0.5;

struct Splat {
    @builtin(position) position: vec4f,
    // Within the disc where shorter than 1.
    @location(0) disc: vec2f,
    @location(1) @interpolate(flat) light: vec3f,
    // Relative to the eye.
    @location(2) at: vec3f,
    @location(3) @interpolate(flat) centre: vec3f,
    // Of the sample's pixel, metres.
    @location(4) @interpolate(flat) side: f32,
}

// The unit vector of two bytes on the octahedron; bytes of 128 are 0.
fn unit(octahedron: vec2f) -> vec3f {
    let v = max((octahedron * 255.0 - 128.0) / 127.0, vec2f(-1.0));
    let z = 1.0 - abs(v.x) - abs(v.y);
    let folded = (1.0 - abs(v.yx)) * select(vec2f(-1.0), vec2f(1.0), v >= vec2f(0.0));
    return normalize(vec3f(select(v, folded, z < 0.0), z));
}

fn normal_at(pixel: vec2u) -> vec3f {
    if item.counts.y == 0u {
        return item.towards_eye.xyz;
    }
    return unit(textureLoad(normals, pixel, 0).xy);
}

fn position_at(pixel: vec2u, shape: u32) -> vec3f {
    let along = item.right.xyz * (f32(pixel.x) * item.origin.w) + item.up.xyz * (f32(pixel.y) * item.origin.w);
    return item.origin.xyz + along - item.towards_eye.xyz * (f32(shape & DEPTH) * item.right.w);
}

// A point of a face of an environment map, by its number in the list: what environment.wgsl has written.
fn face_splat(number: u32, corner: vec2f) -> Splat {
    var splat: Splat;
    let columns = textureDimensions(shapes).x;
    let entry = textureLoad(shapes, vec2u(number % columns, number / columns), 0).xy;
    let pixel = vec2f(vec2u(entry.x, entry.x >> 12u) & vec2u(0xfffu));
    // Codes are the reciprocal of metres along the face's axis, from 1 for the farthest.
    let distance = item.face.z * 65535.0 / f32(entry.y & 0xffffu);
    let tangent = item.face.xy + pixel * item.origin.w;
    splat.centre = item.origin.xyz + (item.right.xyz * tangent.x + item.up.xyz * tangent.y - item.towards_eye.xyz) * distance;
    splat.side = item.origin.w * distance;
    splat.disc = corner;
    splat.at = splat.centre + (frame.right.xyz * corner.x + frame.up.xyz * corner.y) * (item.up.w * splat.side);
    splat.position = frame.clip_from_relative * vec4f(splat.at, 1.0);
    splat.light = from_srgb(vec3f(vec3u(entry.x >> 24u, entry.y >> 16u, entry.y >> 24u) & vec3u(0xffu)) / 255.0);
    return splat;
}

// Pixels are numbered tile by tile, row by row within each: a tile is one range of vertices. Tiles of the last column and
// row may reach beyond the image.
fn pixel_of(number: u32) -> vec2u {
    let columns = item.size.z;
    let area = columns * item.size.w;
    let tile = number / area;
    let within = number - tile * area;
    let row = within / columns;
    return vec2u((tile & 3u) * columns + within - row * columns, (tile >> 2u) * item.size.w + row);
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Splat {
    var splat: Splat;
    // Beyond the near plane: nothing is drawn.
    splat.position = vec4f(0.0, 0.0, 2.0, 1.0);
    let corner = vec2f(f32(index & 1u), f32((index >> 1u) & 1u)) * 2.0 - 1.0;
    if item.counts.z == 1u {
        return face_splat(index >> 2u, corner);
    }
    let pixel = pixel_of(index >> 2u);
    if any(pixel >= item.size.xy) {
        return splat;
    }
    let shape = textureLoad(shapes, pixel, 0).x;
    if (shape & PRESENT) == 0u {
        return splat;
    }
    let centre = position_at(pixel, shape);
    let side = item.origin.w;
    splat.side = side;
    splat.disc = corner;
    if item.counts.x != 0u && is_hidden_around(centre, 3.0 * side) {
        return splat;
    }
    let normal = normal_at(pixel);
    var is_disc = frame.size.z == ELLIPTICAL || (shape & CONNECTED) != 0u;
    if frame.size.z == HYBRID_NO_SPHERICALITY {
        is_disc = is_connected(pixel, shape);
    }
    var u = frame.right.xyz;
    var v = frame.up.xyz;
    var radius = item.up.w;
    if frame.size.z == CIRCULAR {
        radius = 0.5;
    } else if frame.size.z == WARPED {
        let there = abs(dot(normal, normalize(centre)));
        let here = max(dot(normal, item.towards_eye.xyz), 1.0 / SLOPE_MAX);
        radius *= sqrt(there / here);
    } else if is_disc && item.counts.y == 1u {
        let facing = max(dot(normal, item.towards_eye.xyz), 1e-4);
        var slope = vec2f(dot(normal, item.right.xyz), dot(normal, item.up.xyz)) / facing;
        slope *= min(1.0, SLOPE_MAX / max(length(slope), 1e-6));
        u = item.right.xyz - item.towards_eye.xyz * slope.x;
        v = item.up.xyz - item.towards_eye.xyz * slope.y;
    }
    splat.centre = centre;
    splat.at = centre + (u * corner.x + v * corner.y) * (radius * side);
    splat.position = frame.clip_from_relative * vec4f(splat.at, 1.0);
    splat.light = shaded(textureLoad(colours, pixel, 0).xyz, normal);
    return splat;
}

// Whether all within `reach` of a point is left out.
fn is_hidden_around(at: vec3f, reach: f32) -> bool {
    for (var i = 0u; i < item.counts.x; i++) {
        if all(at > item.hidden[2u * i].xyz + reach) && all(at < item.hidden[2u * i + 1u].xyz - reach) {
            return true;
        }
    }
    return false;
}

struct Written {
    @location(0) colour: vec4f,
    @builtin(sample_mask) mask: u32,
    @builtin(frag_depth) depth: f32,
}

// The standard places of four samples, from the pixel's middle.
const PLACES = array<vec2f, 4>(
    vec2f(-0.125, -0.375), vec2f(0.375, -0.125), vec2f(-0.375, 0.125), vec2f(0.125, 0.375));

@fragment
fn fragment(splat: Splat) -> Written {
    var out: Written;
    out.mask = 0xfu;
    if SAMPLES == 1u {
        if dot(splat.disc, splat.disc) > 1.0 {
            discard;
        }
    } else {
        let across = dpdx(splat.disc);
        let down = dpdy(splat.disc);
        out.mask = 0u;
        for (var i = 0u; i < 4u; i++) {
            let place = PLACES[i];
            let disc = splat.disc + across * place.x + down * place.y;
            out.mask |= select(0u, 1u << i, dot(disc, disc) <= 1.0);
        }
    }
    if item.counts.x != 0u && is_hidden(splat.at) {
        discard;
    }
    // Farther back by the square of the distance from the middle: where discs overlap, the nearest sample is shown.
    let aside = splat.at - splat.centre;
    let back = BULGE * dot(aside, aside) / splat.side + item.towards_eye.w;
    out.depth = frame.forward.w / (1.0 / splat.position.w + back);
    out.colour = written(splat.light);
    return out;
}
