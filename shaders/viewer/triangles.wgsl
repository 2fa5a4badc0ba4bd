// Pictures in motion of a view with dense grids: the triangles of their level sets (web/src/surface.ts), lit at their
// corners and without shadows. Triangles are about as small as pixels, and each part of a pixel would be lit otherwise.

#import light
#import viewer_table

// The row of the table for the instance that is drawn.
struct Own {
    texels: array<vec4f, 24>,
}

// Two texels of the table for each light.
struct Lights {
    texels: array<vec4f, 32>,
}

@group(0) @binding(5) var<uniform> own: Own;
@group(0) @binding(6) var<uniform> lights: Lights;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) color: vec3f,
}

// A corner of a triangle: its place and a vector along the gradient in field space.
@vertex
fn triangle_corner(@location(0) place: vec3f, @location(1) slope: vec3f) -> Corner {
    let place_field = vec4f(place, 1.0);
    let p = vec3f(dot(own.texels[9], place_field), dot(own.texels[10], place_field), dot(own.texels[11], place_field));
    let to_eye = normalize(view.eye.xyz - p);
    let along = slope.x * own.texels[6].xyz + slope.y * own.texels[7].xyz + slope.z * own.texels[8].xyz;
    let normal = along / max(length(along), SHORTEST);
    let tint = own.texels[12];
    let glow = own.texels[13];
    var color = glow.xyz + tint.xyz;
    if (u32(own.texels[17].w) & FLAG_UNLIT) == 0u {
        let ambient = select(view.light.x, ambient_light(normal, view.light.x), view.light.y == 1.0);
        color = glow.xyz + ambient * tint.xyz;
        for (var i = 0u; i < u32(view.light.z); i++) {
            let origin = lights.texels[2u * i];
            let way = select(origin.xyz, normalize(p - origin.xyz), origin.w == 1.0);
            color += light_adds(Light(way, 0u, lights.texels[2u * i + 1u].xyz, 0u), tint.xyz, normal, to_eye, tint.w, glow.w);
        }
    }
    let p_scene = vec4f(p, 1.0);
    let w = dot(view.clip_w, p_scene);
    let clip = vec4f(dot(view.clip_x, p_scene), dot(view.clip_y, p_scene), view.clip_z.x * w + view.clip_z.y, w);
    return Corner(clip, srgb(color));
}

@fragment
fn triangle_color(corner: Corner) -> @location(0) vec4f {
    return vec4f(corner.color, 1.0);
}
