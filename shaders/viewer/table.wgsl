// The table of instances, lights and rays of a view: one texture of numbers, which has a row for each instance.
//
// Row of an instance, texels of four floats. Indices count words and are below 2^24, so that floats have them exactly.
//
//     texel 0-2   start of the rays: of the middle, what one unit to the right and up on the plane at depth 1 adds.
//                 The fourth number of texel 0 is the depth of the start.
//           3-5   their direction, one unit of depth long: likewise
//           6-8   field from scene, rows of 3 x 4
//           9-11  scene from field
//           12    colour, strength of the highlight
//           13    emission, sharpness of the highlight
//           14    kind, encoding, scale, first sample
//           15    voxels (3), bytes of empty space
//           16    blocks or bricks (3), masks of cells
//           17    lower corner in field space (3), flags
//           18    upper corner (3), object
//           19    world units of a distance of 1, bias of shadow rays, structure, 1 / Lipschitz constant
//           20    index of bricks or vertices and faces of a mesh, nodes, floor, longest step
//           21    node step (3), errors of the samples (bytes)
//           22    place in the filtered texture: first layer, texels per voxel, distance of 1.0, one over the
//                 difference between neighbouring samples that 1 % of the pairs exceed
//           23    share of the view's largest error at a byte of 255; 1 if the drawn triangles belong to a mesh; index
//                 of the instance
//
// Row `count` has the rays of scene space. The rows after it are lights:
//
//     texel 0     direction in which the light travels, and 0; or position in scene space, and 1
//           1     colour, range in scene units; range 0: no falloff. With a range, the colour is the one at a
//                 distance of one scene unit.
//           2     axis of the cone of a spot light, cosine of its inner angle
//           3     cosine of its outer angle: below -1 for all directions; three unused numbers

struct View {
    // Width and height of the picture, pixels; side of a pixel at depth 1; number of instances.
    size: vec4f,
    background: vec4f,
    // Ambient light, an unused number, number of lights, kind of picture.
    light: vec4f,
    // Level of the surface, distance of iso-lines, range of colours, largest number of steps: world units.
    level: vec4f,
    // Slice plane in scene space: points with dot(xyz, p) = w; xyz zero for none.
    slice: vec4f,
    // Box of the slice, scene space.
    slice_lower: vec4f,
    slice_upper: vec4f,
    // World units of a scene unit; 1 cuts the half of the slice on the side of the eye away; two unused numbers.
    scene: vec4f,
    // One over the size of the filtered texture; one unused number.
    filtered: vec4f,
    // Clip space from scene space: rows for x, y and w. The depth in clip space is clip_z.x * w + clip_z.y.
    clip_x: vec4f,
    clip_y: vec4f,
    clip_z: vec4f,
    clip_w: vec4f,
    // Scene space.
    eye: vec4f,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(2) var frames: texture_2d<f32>;

// The depth of a ray that hits nothing.
const NO_DEPTH: f32 = 3.0e38;

const FLAG_VISIBLE: u32 = 1u;
const FLAG_CASTS: u32 = 2u;
const FLAG_UNLIT: u32 = 4u;

fn frame_at(row: u32, texel: u32) -> vec4f {
    return textureLoad(frames, vec2i(i32(texel), i32(row)), 0);
}

// The three rows of a 3 x 4 matrix, times a point or a direction.
fn moved(instance: u32, first: u32, p: vec4f) -> vec3f {
    return vec3f(
        dot(frame_at(instance, first), p), dot(frame_at(instance, first + 1u), p), dot(frame_at(instance, first + 2u), p)
    );
}

// The transpose of the 3 x 3 part of a 3 x 4 matrix, times a vector.
fn moved_by_transpose(instance: u32, first: u32, v: vec3f) -> vec3f {
    return v.x * frame_at(instance, first).xyz + v.y * frame_at(instance, first + 1u).xyz
        + v.z * frame_at(instance, first + 2u).xyz;
}

// A light as a point of scene space receives it, and the distance to it in scene units.
struct NearLight {
    light: Light,
    reach: f32,
}

// The light of the texels of a row, as a point of scene space receives it. Twin of `seen_from` in
// src/scene/light/lit_surface.rs.
fn light_from(place: vec4f, color: vec4f, axis: vec4f, outer: f32, p: vec3f) -> NearLight {
    if place.w == 0.0 { return NearLight(Light(place.xyz, 0u, color.xyz, 0u), NO_DEPTH); }
    let way = place.xyz - p;
    let reach = max(length(way), 1e-12);
    let direction = -way / reach;
    var left = 1.0;
    if color.w > 0.0 {
        let share = min(reach / color.w, 1.0);
        left = (1.0 - share * share * share * share) / (reach * reach);
    }
    let cosine = dot(axis.xyz, direction);
    if cosine <= outer {
        left = 0.0;
    } else if cosine < axis.w {
        let ramp = (cosine - outer) / (axis.w - outer);
        left *= ramp * ramp;
    }
    return NearLight(Light(direction, 0u, left * color.xyz, 0u), reach);
}

// The light of a row of the table.
fn light_at(row: u32, p: vec3f) -> NearLight {
    return light_from(frame_at(row, 0u), frame_at(row, 1u), frame_at(row, 2u), frame_at(row, 3u).x, p);
}

// IEC 61966-2-1.
fn srgb(linear: vec3f) -> vec3f {
    let cut = clamp(linear, vec3f(0.0), vec3f(1.0));
    return select(1.055 * pow(max(cut, vec3f(0.0031308)), vec3f(1.0 / 2.4)) - 0.055, 12.92 * cut, cut <= vec3f(0.0031308));
}
