// Finds the field that each pixel shows. The box of each instance's surface is rasterised; a fragment traces the field
// to the exact hit and writes its depth. Twin of `field_hit` in src/scene/visibility/pixel_ray.rs.

#import scene_view
#import scene_objects

struct BoxCorner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat) row: u32,
}

// The 12 triangles of a box, two per side, counter-clockwise from outside. Bits 0, 1 and 2 of a corner are its x, y and
// z.
const CORNERS = array<u32, 36>(
    0u, 4u, 6u, 0u, 6u, 2u, 1u, 3u, 7u, 1u, 7u, 5u, 0u, 1u, 5u, 0u, 5u, 4u,
    2u, 6u, 7u, 2u, 7u, 3u, 0u, 2u, 3u, 0u, 3u, 1u, 4u, 5u, 7u, 4u, 7u, 6u,
);
// The rasterised box is enlarged by this fraction of its sides, which exceeds the rounding error of its corners.
const BOX_MARGIN: f32 = 1e-3;

const AT_START: u32 = 1u;
const RAN_OUT: u32 = 2u;

@vertex
fn box_corner(@builtin(vertex_index) vertex: u32, @builtin(instance_index) row: u32) -> BoxCorner {
    // The back faces are rasterised, because the eye may be inside the box. A mirrored instance reverses the winding.
    let place = select(vertex, vertex - vertex % 3u + (3u - vertex % 3u) % 3u, rows[row].is_mirrored != 0u);
    var corners = CORNERS;
    let corner = corners[place];
    let to = &instances[rows[row].index];
    let share = vec3f(f32(corner & 1u), f32((corner >> 1u) & 1u), f32(corner >> 2u));
    let margin = BOX_MARGIN * ((*to).surface_upper - (*to).surface_lower);
    let p = mix((*to).surface_lower - margin, (*to).surface_upper + margin, share);
    return BoxCorner(clip_position(row, p), row);
}

struct FieldSeen {
    // x: index of the instance + 1. y: flags. z: depth in scene units, as float bits. w: number of steps.
    @location(0) seen: vec4u,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn field_seen(corner: BoxCorner, @builtin(front_facing) is_front: bool) -> FieldSeen {
    if is_front { discard; }
    let row = corner.row;
    let index = rows[row].index;
    let through = ray_through(row, corner.position.xy);
    let ray = FieldRay(through.start, through.along);
    steps = 0u;
    let to = &instances[index];
    let span = clip(ray.origin, ray.direction, (*to).surface_lower, (*to).surface_upper, vec2f(0.0, FAR_T));
    if span.x > span.y { discard; }
    let hit = field_hit(fields[(*to).field], ray.origin + span.x * ray.direction, ray.direction, span.y - span.x);
    let ran_out = steps >= MAX_STEPS;
    if hit < 0.0 && !ran_out { discard; }
    let t = max(span.x + max(hit, 0.0), NEAR);
    let flags = select(0u, AT_START, hit == 0.0) | select(0u, RAN_OUT, ran_out);
    let linear_depth = dot(rows[row].clip_depth, vec4f(ray.origin + t * ray.direction, 1.0));
    let depth = select(NEAR / t, linear_depth, rows[row].is_parallel != 0u);
    return FieldSeen(vec4u(index + 1u, flags, bitcast<u32>(t), steps), depth);
}
