// Colour of a lit surface: Blinn-Phong under directional lights and a hemisphere of ambient light. Twin of
// src/render/shade.rs.

struct Light {
    // The way the light travels, unit.
    direction: vec3f,
    pad_0: u32,
    color: vec3f,
    pad_1: u32,
}

// Ambient light that comes from below, as a share of the light from above.
const GROUND_SHARE: f32 = 0.4;
const MAX_LIGHTS: u32 = 64u;
// Smallest normal number, rounded up: what is shorter has no direction.
const SHORTEST: f32 = 1.2e-38;

// From the ground (normal down) to the sky (normal up).
fn ambient_light(normal: vec3f, ambient: f32) -> f32 {
    let sky = 0.5 + 0.5 * normal.y;
    return ambient * (GROUND_SHARE + (1.0 - GROUND_SHARE) * sky);
}

// What one light adds where all of it arrives.
fn light_adds(light: Light, color: vec3f, normal: vec3f, to_eye: vec3f, specular: f32, shininess: f32) -> vec3f {
    let to_light = -light.direction;
    let cosine = dot(normal, to_light);
    if cosine <= 0.0 { return vec3f(0.0); }
    let between = to_light + to_eye;
    let half_way = between / max(length(between), SHORTEST);
    let highlight = specular * pow(max(dot(normal, half_way), 0.0), shininess);
    return light.color * (cosine * color + highlight);
}
