// What is drawn at a time.

struct Item {
    // What the content's positions are relative to: the middle of the first pixel, a mesh's origin, or where a face is seen from.
    // w: side of a pixel, metres; of a face's at distance 1.
    origin: vec4f,
    // Image axes, unit; w of the first: metres of a step of depth; of the second: the disc's radius in pixels; of the third: metres
    // by which all stands back.
    right: vec4f,
    up: vec4f,
    towards_eye: vec4f,
    // Linear light; w: 1 if the content is shown in it, 0 if in its own colours.
    tint: vec4f,
    // Columns and rows of the image, and of a tile.
    size: vec4u,
    // x: boxes that are left out; y: 1 if the image has normals; z: 1 if it is a face of an environment map.
    counts: vec4u,
    // Of a face: the tangents of the first pixel's middle to the right and upwards; metres along the face's axis at the largest
    // code of depth.
    face: vec4f,
    // Least and greatest corners of the boxes in turn.
    hidden: array<vec4f, 16>,
}

@group(1) @binding(0) var<uniform> item: Item;

fn is_hidden(at: vec3f) -> bool {
    for (var i = 0u; i < item.counts.x; i++) {
        if all(at > item.hidden[2u * i].xyz) && all(at < item.hidden[2u * i + 1u].xyz) {
            return true;
        }
    }
    return false;
}

// A surface's light towards the camera. A false colour keeps a third of its brightness where the content is black.
fn shaded(colour: vec3f, normal: vec3f) -> vec3f {
    let brightness = dot(colour, vec3f(0.2126, 0.7152, 0.0722));
    let own = mix(colour, item.tint.xyz * (0.33 + 0.67 * sqrt(brightness)), item.tint.w);
    let lit = frame.sun.w + (1.0 - frame.sun.w) * max(0.0, dot(normal, frame.sun.xyz));
    return own * lit;
}
