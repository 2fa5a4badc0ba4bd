// Colour of a lit surface: Blinn-Phong reflection of directional lights. Twin of src/picture/lit_point.rs and
// src/render/shade.rs.

struct Light {
    // Direction in which the light travels, unit length.
    direction: vec3f,
    pad_0: u32,
    color: vec3f,
    pad_1: u32,
}

// Slightly above the smallest normal float32. A shorter vector has no direction.
const SHORTEST: f32 = 1.2e-38;

// Contribution of one unoccluded light to the colour.
fn light_adds(light: Light, color: vec3f, normal: vec3f, to_eye: vec3f, specular: f32, shininess: f32) -> vec3f {
    let to_light = -light.direction;
    let cosine = dot(normal, to_light);
    if cosine <= 0.0 { return vec3f(0.0); }
    let between = to_light + to_eye;
    let half_way = between / max(length(between), SHORTEST);
    let highlight = specular * pow(max(dot(normal, half_way), 0.0), shininess);
    return light.color * (cosine * color + highlight);
}
