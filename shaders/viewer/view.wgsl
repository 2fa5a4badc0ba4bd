// The picture of a view in a browser: a fragment finds the first hit of its ray among the fields of all instances,
// sends a ray to each light, and shades the hit as fieldbake.raymarch does. Twin of src/picture/lit_point.rs,
// src/render/shade.rs and src/scene/lighting/compose.rs.
//
// One loop holds the ray from the eye and the rays to the lights, because drivers inline functions at each call.

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

// Kinds of pictures. From PICTURE_DEPTH on, a pixel is the four bytes of a float32.
const PICTURE_COLOR: u32 = 0u;
const PICTURE_STEPS: u32 = 1u;
const PICTURE_DEPTH: u32 = 2u;
const PICTURE_NORMAL: u32 = 3u;
const PICTURE_OBJECT: u32 = 6u;
const PICTURE_SLICE: u32 = 7u;
const PICTURE_ERROR: u32 = 8u;

struct Found {
    depth: f32,
    instance: u32,
    object: u32,
    // Field space.
    p: vec3f,
    along: vec3f,
    at_start: bool,
    enter_axis: u32,
}

// The paint of a shape's own over a colour.
fn painted(color: vec3f, p: vec3f) -> vec3f {
    let paint = structure_color(structure, p);
    return select(color, paint, paint.x >= 0.0);
}

// A direction of any length, unit; `fallback` for zero. Scaled by its largest entry first, so that squares stay in
// range.
fn unit_or(v: vec3f, fallback: vec3f) -> vec3f {
    let sizes = abs(v);
    let largest = max(sizes.x, max(sizes.y, sizes.z));
    if largest < TINY { return fallback; }
    return normalize(v / largest);
}

// The colours of Frame.heatmap, sRGB.
fn heat(share: f32) -> vec3f {
    let s = clamp(share, 0.0, 1.0) * 4.0;
    let a = mix(vec3f(0.03, 0.03, 0.12), vec3f(0.25, 0.12, 0.45), clamp(s, 0.0, 1.0));
    let b = mix(a, vec3f(0.70, 0.20, 0.42), clamp(s - 1.0, 0.0, 1.0));
    let c = mix(b, vec3f(0.96, 0.50, 0.25), clamp(s - 2.0, 0.0, 1.0));
    return mix(c, vec3f(1.00, 0.92, 0.60), clamp(s - 3.0, 0.0, 1.0));
}

fn as_bytes(value: f32) -> vec4f {
    let bits = bitcast<u32>(value);
    let bytes = vec4u(bits & 255u, (bits >> 8u) & 255u, (bits >> 16u) & 255u, bits >> 24u);
    return vec4f(bytes) / 255.0;
}

// The least distance to the fields at a point of scene space, world units.
fn distance_to_scene(p: vec3f, count: u32) -> f32 {
    var least = NO_DEPTH;
    for (var i = 0u; i < count; i++) {
        select_field(i);
        let lower = frame_at(i, 17u);
        if (u32(lower.w) & FLAG_VISIBLE) == 0u || kind == KIND_QUADRIC { continue; }
        let q = moved(i, 6u, vec4f(p, 1.0));
        let inside = clamp(q, lower.xyz, frame_at(i, 18u).xyz);
        var value = field_value(q, inside) * unit;
        // Outside its box a sampled field is known at the nearest point of the box only.
        if kind != KIND_SHAPE {
            let away = moved(i, 9u, vec4f(q - inside, 0.0)) * view.scene.x;
            value = select(value, sqrt(dot(away, away) + max(value, 0.0) * max(value, 0.0)), dot(away, away) > 0.0);
        }
        least = min(least, value);
    }
    return least;
}

// Colour, sRGB, and opacity of the slice plane where the distance has this value; `pixel` is the side of a pixel there.
fn slice_color(value: f32, pixel: f32) -> vec4f {
    let spacing = view.level.y;
    let near_line = abs(value / spacing - round(value / spacing)) * spacing;
    let line = 1.0 - smoothstep(0.6 * pixel, 1.5 * pixel, near_line);
    let zero = 1.0 - smoothstep(1.2 * pixel, 2.4 * pixel, abs(value));
    let share = clamp(abs(value) / view.level.z, 0.0, 1.0);
    // Lines are seen against both fills, and fade where they are closer than pixels.
    let faded = line * clamp(0.25 * spacing / pixel - 0.5, 0.0, 1.0);
    var color = mix(vec3f(0.96, 0.82, 0.56), vec3f(0.74, 0.29, 0.10), sqrt(share));
    var opacity = 0.34;
    if value <= 0.0 {
        color = mix(vec3f(0.66, 0.85, 0.92), vec3f(0.07, 0.28, 0.52), sqrt(share));
        opacity = 1.0;
    }
    color = mix(color, vec3f(0.10, 0.10, 0.12), 0.55 * faded);
    color = mix(color, vec3f(1.0), zero);
    return vec4f(color, max(opacity, max(0.55 * faded, zero)));
}

// A linear function of the pixel: the start of its ray from row 0, its direction from row 3. `aside` is the position of
// the pixel right of and above the middle of the picture, at depth 1.
fn pixel_sum(instance: u32, row: u32, aside: vec2f) -> vec3f {
    let middle = frame_at(instance, row).xyz;
    return middle + aside.x * frame_at(instance, row + 1u).xyz + aside.y * frame_at(instance, row + 2u).xyz;
}

// The slice plane on the ray of a pixel.
struct SliceHit {
    // Depth along the viewing axis, world units; NO_DEPTH without a hit.
    depth: f32,
    // Depth before which the ray is in the half that is cut away; NO_DEPTH if all of it is.
    near: f32,
    // Scene space.
    p: vec3f,
}

// The ray has the start `start` and the direction `along`, in scene space. `start_depth` is the depth of the start
// along the viewing axis, world units.
fn slice_hit(start: vec3f, along: vec3f, start_depth: f32) -> SliceHit {
    var hit = SliceHit(NO_DEPTH, 0.0, vec3f(0.0));
    if !HAS_SLICE { return hit; }
    let descent = dot(view.slice.xyz, along);
    if dot(view.slice.xyz, view.slice.xyz) > 0.0 && descent != 0.0 {
        let t = (view.slice.w - dot(view.slice.xyz, start)) / descent;
        hit.p = start + t * along;
        let is_there = all(hit.p >= view.slice_lower.xyz) && all(hit.p <= view.slice_upper.xyz);
        let depth = start_depth + t;
        if depth > 0.0 && is_there { hit.depth = depth; }
        // The half on the side of the eye is cut away. The normal of the plane points to that side.
        if view.scene.y == 1.0 && depth > 0.0 && descent < 0.0 { hit.near = depth; }
    }
    // A ray that does not descend to the plane stays in the half of the eye.
    if view.scene.y == 1.0 && descent >= 0.0 { hit.near = NO_DEPTH; }
    return hit;
}

// The visible surface of a pixel.
struct Surface {
    // Scene space, with a unit normal.
    p: vec3f,
    normal: vec3f,
    // Start of the rays to lights, in the space of its own field.
    own_start: vec3f,
    // Linear RGB: the fraction of the light that it reflects, and the light that it emits.
    albedo: vec3f,
    glow: vec3f,
    specular: f32,
    shininess: f32,
    is_unlit: bool,
}

fn surface_of(found: Found, to_eye: vec3f) -> Surface {
    let own = found.instance;
    let lower = frame_at(own, 17u);
    select_field(own);
    var slope = vec3f(0.0);
    if !found.at_start {
        slope = field_slope(found.p, -found.along, lower.xyz, frame_at(own, 18u).xyz);
    } else if found.enter_axis != NO_AXIS {
        // The cut on a face of the box.
        slope[found.enter_axis] = select(1.0, -1.0, found.along[found.enter_axis] > 0.0);
    }
    let normal = unit_or(moved_by_transpose(own, 6u, slope), to_eye);
    let offset = bias * length(moved_by_transpose(own, 9u, normal));
    let own_start = found.p + offset * moved(own, 6u, vec4f(normal, 0.0));
    let tint = frame_at(own, 12u);
    let glow = frame_at(own, 13u);
    var albedo = tint.xyz;
    if HAS_SHAPE && kind == KIND_SHAPE { albedo = painted(albedo, found.p); }
    let is_unlit = (u32(lower.w) & FLAG_UNLIT) != 0u;
    let p = moved(own, 9u, vec4f(found.p, 1.0));
    return Surface(p, normal, own_start, albedo, glow.xyz, tint.w, glow.w, is_unlit);
}

// The pictures of values in place of colours.
fn value_picture(picture: u32, found: Found, normal: vec3f, to_eye: vec3f, ray_steps: u32, color: vec3f) -> vec4f {
    if picture == PICTURE_DEPTH { return as_bytes(found.depth); }
    if picture == PICTURE_OBJECT { return as_bytes(select(-1.0, f32(found.object), found.depth < NO_DEPTH)); }
    if picture == PICTURE_STEPS { return vec4f(heat(f32(ray_steps) / view.level.w), 1.0); }
    if picture < PICTURE_ERROR { return as_bytes(normal[min(picture - PICTURE_NORMAL, 2u)]); }
    if found.depth == NO_DEPTH { return vec4f(srgb(color), view.background.w); }
    // Surfaces that face away from the eye are darker, so that the form stays visible.
    return vec4f(heat(error_share(found.instance, found.p)) * (0.5 + 0.5 * abs(dot(normal, to_eye))), 1.0);
}

@fragment
fn main(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let picture = u32(view.light.w);
    let count = u32(view.size.w);
    let light_count = u32(view.light.z);
    let aside = (position.xy - 0.5 * view.size.xy) * view.size.z;

    // The slice plane on the ray. Row `count` of the frames holds the rays of scene space.
    let scene_along = pixel_sum(count, 3u, aside);
    let to_eye = -normalize(scene_along);
    let cut = slice_hit(pixel_sum(count, 0u, aside), scene_along, frame_at(count, 0u).w);
    var slice_value = NO_DEPTH;
    if HAS_SLICE && cut.depth < NO_DEPTH { slice_value = distance_to_scene(cut.p, count) + view.level.x; }
    if HAS_SLICE && !IS_MOTION && picture == PICTURE_SLICE { return as_bytes(slice_value); }

    var found: Found;
    found.depth = NO_DEPTH;
    var surface: Surface;
    var color = view.background.xyz;
    var ray_steps = 0u;
    steps = 0u;
    let is_color = picture == PICTURE_COLOR;
    for (var r = 0u; r <= light_count; r++) {
        var light: Light;
        var reach = NO_DEPTH;
        if r > 0u {
            let found_light = light_at(count + r, surface.p);
            light = found_light.light;
            reach = found_light.reach;
            if dot(surface.normal, light.direction) >= 0.0 { continue; }
        }
        var is_dark = false;
        for (var i = 0u; i < count; i++) {
            let lower = frame_at(i, 17u);
            let upper = frame_at(i, 18u);
            if (u32(lower.w) & select(FLAG_CASTS, FLAG_VISIBLE, r == 0u)) == 0u { continue; }
            var start = surface.own_start;
            var along = vec3f(0.0);
            var before = 0.0;
            if r == 0u {
                before = frame_at(i, 0u).w;
                start = pixel_sum(i, 0u, aside);
                along = pixel_sum(i, 3u, aside);
            } else {
                along = moved(i, 6u, vec4f(-light.direction, 0.0));
                if i != found.instance { start = moved(i, 6u, vec4f(surface.p, 1.0)); }
            }
            var ray = clip_to_field(start, along, lower.xyz, upper.xyz);
            if !ray.is_in_box { continue; }
            let per_t = length(along);
            let skipped = cut.near - before - ray.t_enter;
            if r == 0u && skipped > 0.0 {
                ray.origin = start + (cut.near - before) * along;
                ray.t_max -= skipped * per_t;
                ray.t_enter = cut.near - before;
                ray.enter_axis = NO_AXIS;
            }
            let end = min(ray.t_max, (select(found.depth - before, reach, r > 0u) - ray.t_enter) * per_t);
            if end < 0.0 { continue; }
            select_field(i);
            let t = field_hit(ray.origin, ray.direction, end);
            if t < 0.0 { continue; }
            if r > 0u {
                is_dark = true;
                break;
            }
            let depth = before + ray.t_enter + t / per_t;
            if depth >= found.depth { continue; }
            found = Found(depth, i, u32(upper.w), ray.origin + t * ray.direction, along, t == 0.0, ray.enter_axis);
        }
        if r > 0u {
            if !is_dark {
                color += light_adds(
                    light, surface.albedo, surface.normal, to_eye, surface.specular, surface.shininess
                );
            }
            continue;
        }
        ray_steps = steps;
        if found.depth == NO_DEPTH { break; }
        if !IS_MOTION && (picture == PICTURE_STEPS || picture == PICTURE_DEPTH || picture == PICTURE_OBJECT) { break; }

        surface = surface_of(found, to_eye);
        if (!is_color && !IS_MOTION) || surface.is_unlit {
            color = surface.glow + surface.albedo;
            break;
        }
        color = surface.glow + view.light.x * surface.albedo;
    }

    if !IS_MOTION && !is_color { return value_picture(picture, found, surface.normal, to_eye, ray_steps, color); }
    var shown = vec4f(srgb(color), select(view.background.w, 1.0, found.depth < NO_DEPTH));
    if HAS_SLICE && cut.depth < NO_DEPTH && (cut.depth <= found.depth || cut.near > 0.0) {
        let cosine = abs(dot(normalize(view.slice.xyz), to_eye));
        let over = slice_color(slice_value, view.size.z * cut.depth / max(cosine, 0.2));
        shown = vec4f(mix(shown.xyz, over.xyz, over.w), max(shown.w, over.w));
    }
    return shown;
}
