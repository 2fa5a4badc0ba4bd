// Draws the triangles of meshes in still pictures. Each pixel is lit, and rays through the fields of all instances find
// its shadows.

#import clip
#import cubic
#import decode
#import light
#import viewer_needs
#import bricks_march
#import viewer_table
#import viewer_data
#import sampling
#import quadric
#import csg_root
#import viewer_shapes
#import viewer_hits
#import viewer_corner

struct LitCorner {
    @builtin(position) clip: vec4f,
    // Scene space.
    @location(0) p: vec3f,
    @location(1) normal: vec3f,
}

// A corner of a triangle: its place and a vector along the gradient in field space.
@vertex
fn lit_corner(@location(0) place: vec3f, @location(1) slope: vec3f) -> LitCorner {
    let p = corner_point(place);
    return LitCorner(corner_clip(p), p, corner_normal(slope, normalize(view.eye.xyz - p)));
}

// Whether the ray to a light hits a field. It starts at `p`, and in the field of instance `own_index` at `own_start`.
// The same ray as in the loop over lights of view.wgsl, which has one call of `field_hit` for all rays.
fn is_shadowed(p: vec3f, own_index: u32, own_start: vec3f, near: NearLight) -> bool {
    for (var i = 0u; i < u32(view.size.w); i++) {
        let lower = frame_at(i, 17u);
        if (u32(lower.w) & FLAG_CASTS) == 0u { continue; }
        let along = moved(i, 6u, vec4f(-near.light.direction, 0.0));
        var start = own_start;
        if i != own_index { start = moved(i, 6u, vec4f(p, 1.0)); }
        let ray = clip_to_field(start, along, lower.xyz, frame_at(i, 18u).xyz);
        let end = min(ray.t_max, (near.reach - ray.t_enter) * length(along));
        if !ray.is_in_box || end < 0.0 { continue; }
        select_field(i);
        if field_hit(ray.origin, ray.direction, end) >= 0.0 { return true; }
    }
    return false;
}

@fragment
fn lit_color(corner: LitCorner) -> @location(0) vec4f {
    let tint = own.texels[12];
    let glow = own.texels[13];
    if (u32(own.texels[17].w) & FLAG_UNLIT) != 0u { return vec4f(srgb(glow.xyz + tint.xyz), 1.0); }
    let p = corner.p;
    let to_eye = normalize(view.eye.xyz - p);
    let normal = normalize(corner.normal);
    let own_index = u32(own.texels[23].z);
    // A shadow ray starts one voxel of the field above its triangle. At most places the field and its triangle differ
    // by less than that.
    let offset = length(moved_by_transpose(own_index, 9u, normal));
    let own_start = moved(own_index, 6u, vec4f(p + offset * normal, 1.0));
    var color = glow.xyz + view.light.x * tint.xyz;
    let first = u32(view.size.w) + 1u;
    for (var i = first; i < first + u32(view.light.z); i++) {
        let near = light_at(i, p);
        if dot(normal, near.light.direction) >= 0.0 || is_shadowed(p, own_index, own_start, near) { continue; }
        color += light_adds(near.light, tint.xyz, normal, to_eye, tint.w, glow.w);
    }
    return vec4f(srgb(color), 1.0);
}
