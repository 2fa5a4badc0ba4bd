// Pictures in motion of a view with dense grids: the triangles of their level sets (web/src/surface.ts), lit at their
// corners and without shadows. Triangles are about as small as pixels, and each part of a pixel would be lit otherwise.

#import light
#import viewer_table
#import viewer_corner

// Four texels of the table for each light.
struct Lights {
    texels: array<vec4f, 64>,
}

@group(0) @binding(6) var<uniform> lights: Lights;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) color: vec3f,
}

// A corner of a triangle: its place and a vector along the gradient in field space.
@vertex
fn triangle_corner(@location(0) place: vec3f, @location(1) slope: vec3f) -> Corner {
    let p = corner_point(place);
    let to_eye = normalize(view.eye.xyz - p);
    let normal = corner_normal(slope, to_eye);
    let tint = own.texels[12];
    let glow = own.texels[13];
    var color = glow.xyz + tint.xyz;
    if (u32(own.texels[17].w) & FLAG_UNLIT) == 0u {
        color = glow.xyz + view.light.x * tint.xyz;
        for (var i = 0u; i < u32(view.light.z); i++) {
            let first = 4u * i;
            let outer = lights.texels[first + 3u].x;
            let near = light_from(
                lights.texels[first], lights.texels[first + 1u], lights.texels[first + 2u], outer, p
            );
            color += light_adds(near.light, tint.xyz, normal, to_eye, tint.w, glow.w);
        }
    }
    return Corner(corner_clip(p), srgb(color));
}

@fragment
fn triangle_color(corner: Corner) -> @location(0) vec4f {
    return vec4f(corner.color, 1.0);
}
