// Computes the fraction of thin rays and cones that passes the instances of a scene. Twin of src/scene/light/shadow.rs
// and cone.rs.

#import scene_occluders

@group(0) @binding(7) var<storage, read> beams: array<Beam>;
@group(0) @binding(8) var<storage, read_write> beam_results: array<BeamResult>;

const TAU: f32 = 6.2831855;

var<private> needs_edge: bool;

// ---- rays

// Fraction of a thin ray that passes.
fn ray_share(beam: Beam) -> f32 {
    var share = 1.0;
    var walk = begin_walk(beam);
    for (var occluder = next_occluder(&walk, beam); occluder.index != NO_INSTANCE; occluder = next_occluder(&walk, beam)) {
        if hit_of(occluder, ray_in_field(occluder.index, beam)) >= 0.0 {
            share *= 1.0 - instances[occluder.index].opacity;
            if share <= 0.0 { return 0.0; }
        }
    }
    return share;
}

// ---- cones, twin of src/scene/light/cone.rs

// Scene distance across the beam for a local distance at a point.
fn across(index: u32, distance: f32, p: vec3f) -> f32 {
    let least = instances[index].least_stretch;
    if instances[index].largest_stretch <= least * 1.0001 { return distance * least; }
    let size = length(scene_normal(index, field_gradient(fields[instances[index].field], p)));
    if size > 0.0 { return distance / size; }
    return distance * least;
}

struct Cone {
    // Signed distance of the nearest edge from the axis in radii, from -1 to 1.
    x: f32,
    is_covered: bool,
}

// Evaluates a cone past one occluder. Only edges closer to the axis than x_known are relevant. Without `with_edges` a
// cone that needs a ray past an edge sets `needs_edge`. The CPU traces the axis only near surfaces; it finds the same
// shares.
fn cone_past(occluder: Occluder, beam: Beam, ray: FieldRay, span: vec2f, x_known: f32, with_edges: bool) -> Cone {
    let t_hit = hit_of(occluder, ray);
    if t_hit < 0.0 && x_known <= 0.0 { return Cone(1.0, false); }
    let deepest = nearest_edge(beam, occluder.index, ray, x_known, span, t_hit);
    if t_hit < 0.0 { return Cone(deepest.x, false); }
    if deepest.x <= -1.0 { return Cone(-1.0, true); }
    // A disc with a blocked axis that no occluder covers is divided, so its own fraction is not used.
    if beam.is_coarse == 0u { return Cone(deepest.x, false); }
    if !with_edges {
        needs_edge = true;
        return Cone(-1.0, false);
    }
    let clearance = largest_clearance_past(occluder, beam, ray, deepest);
    return Cone(clearance * (1.0 + deepest.x) - 1.0, false);
}

// The interval of a cone in which the surface of an occluder may come within `x_known` radii of the axis.
fn cone_span(occluder: Occluder, beam: Beam, ray: FieldRay, x_known: f32) -> vec2f {
    let to = &instances[occluder.index];
    let needed = beam.slope * max(x_known, 0.0);
    let grown = (*to).field_extent * widest(beam.p, needed, (*to).box_min, (*to).box_max, beam.t_max);
    let lower = (*to).surface_lower - grown;
    let upper = (*to).surface_upper + grown;
    let span = clip(ray.origin, ray.direction, lower, upper, occluder.part);
    // Only levels of the far field are skipped.
    if !HAS_FAR || span.x > span.y || occluder.skip == 0.0 { return span; }
    if sampled_distance(fields[(*to).field], ray.origin + span.x * ray.direction) > 0.0 { return span; }
    return clip(ray.origin, ray.direction, lower, upper, occluder.part + vec2f(occluder.skip, 0.0));
}

// The largest clearance of rays past the edges of an occluder in radii, from 0 to 1. See `rays_past` in cone.rs.
fn largest_clearance_past(occluder: Occluder, beam: Beam, ray: FieldRay, deepest: vec2f) -> f32 {
    let index = occluder.index;
    let to = &instances[index];
    let t = deepest.y;
    let depth = -deepest.x * beam.slope * t;
    let beyond = PAST_EDGE * depth + 0.5 / length(ray.direction) * (*to).largest_stretch / (*to).least_stretch;
    if beyond > 2.0 * beam.slope * t { return 0.0; }
    let slope = FULL_CLEARANCE * (beyond * EDGE_COSINE - depth) / t;
    let axes = axes_of(beam.direction);
    let p = ray.origin + t * ray.direction;
    var bounds: array<f32, EDGE_DIRECTIONS>;
    for (var i = 0u; i < EDGE_DIRECTIONS; i++) {
        steps++;
        let angle = f32(i) * (TAU / f32(EDGE_DIRECTIONS));
        let aside = cos(angle) * axes.right + sin(angle) * axes.up;
        let q = p + field_direction(index, beyond * aside);
        bounds[i] = min(across(index, field_distance(fields[(*to).field], q), q) / (slope * t), 1.0);
    }
    var most = 0.0;
    for (var round = 0u; round < EDGE_DIRECTIONS; round++) {
        var first = 0u;
        for (var i = 1u; i < EDGE_DIRECTIONS; i++) {
            if bounds[i] > bounds[first] { first = i; }
        }
        let bound = bounds[first];
        if bound <= most { break; }
        bounds[first] = 0.0;
        let angle = f32(first) * (TAU / f32(EDGE_DIRECTIONS));
        var past = beam;
        past.slope = slope;
        past.is_coarse = 1u;
        if past.cut < ROOT_WITHOUT_OWN { past.cut = ROOT; }
        past.direction = beam.direction + beyond / t * (cos(angle) * axes.right + sin(angle) * axes.up);
        let longer = length(past.direction);
        past.direction /= longer;
        past.t_max = min(beam.t_max * longer, FAR_T);
        let was_far = is_far;
        most = max(most, min(bound, clearance_along(past, index, most)));
        is_far = was_far;
    }
    return most;
}

// The least clearance of the axis of a narrow cone in radii, from 0 to 1: beside the occluder `past`, and beside the
// others that are opaque. The search ends if it is at most `least`.
fn clearance_along(beam: Beam, past: u32, least: f32) -> f32 {
    var own = 1.0;
    var others = 1.0;
    var is_own_found = false;
    var walk = begin_walk(beam);
    for (var occluder = next_occluder(&walk, beam); occluder.index != NO_INSTANCE; occluder = next_occluder(&walk, beam)) {
        let is_own = occluder.index == past;
        if !is_own && (instances[occluder.index].opacity < 1.0 || others <= least) { continue; }
        is_own_found = is_own_found || is_own;
        let ray = ray_in_field(occluder.index, beam);
        var clearance = select(others, own, is_own);
        var is_free = false;
        if !HAS_THIN || instances[occluder.index].prefers_rays == 0u {
            let span = cone_span(occluder, beam, ray, clearance);
            if span.x > span.y { continue; }
            let nearest = nearest_edge(beam, occluder.index, ray, clearance, span, -1.0);
            clearance = nearest.x;
            is_free = nearest.y < 0.0;
        }
        if clearance > 0.0 && !is_free && hit_of(occluder, ray) >= 0.0 { clearance = 0.0; }
        if is_own { own = clearance; } else { others = clearance; }
        if is_own_found && min(own, others) <= least { break; }
    }
    return min(own, others);
}

// A march along the axis of a cone past one occluder.
struct March {
    // The nearest edge so far: see `nearest_edge`.
    nearest: vec2f,
    t: f32,
    end: f32,
    // Half a voxel, scene units.
    least_step: f32,
    // Number of scene units that the axis may advance for one local unit of distance.
    pace: f32,
    // Whether the march is inside the occluder.
    is_blocked: bool,
    is_on: bool,
    // Whether a narrow cone reached the end.
    is_past: bool,
}

// Takes the step from the point at t, where the field has this distance and the cone this radius.
fn advance(march: ptr<function, March>, distance: f32, radius: f32) {
    let at = *march;
    var step = select(distance, -distance, at.is_blocked) * at.pace;
    if !at.is_blocked && step < at.least_step { (*march).nearest.y = 0.0; }
    // Near a narrow cone, half steps find the closest approach to 3 %.
    if at.is_blocked || step < 2.0 * radius { step *= 0.5; }
    step = max(step, at.least_step);
    (*march).t = at.t + step;
    if at.t + step >= at.end {
        (*march).is_on = false;
        (*march).is_past = true;
    }
}

// The nearest edge on the axis of a cone. One function computes all results, because drivers inline functions:
//   free axis:     (smallest clearance in radii, at most x_known; -1)
//   the same, if the steps do not prove that the axis is free:     (that clearance; 0)
//   axis that enters the occluder at t_hit:     (signed distance of the edge in radii, negative; t of the deepest
//   point)
// The march past the whole disc of a light ends at its first edge, as `decide` in cone.rs. Software drivers execute
// all branches in each round of a loop. The gradients and estimates near edges cost more than a step, so they are
// outside of the loop over steps.
fn nearest_edge(beam: Beam, index: u32, ray: FieldRay, x_known: f32, span: vec2f, t_hit: f32) -> vec2f {
    let field = fields[instances[index].field];
    let stretch = instances[index].least_stretch;
    let is_blocked = t_hit >= 0.0;
    var march: March;
    march.least_step = 0.5 / length(ray.direction);
    march.pace = 1.0 / length(local_direction(index, beam.direction));
    march.end = span.y;
    march.is_blocked = is_blocked;
    march.is_on = true;
    march.nearest = vec2f(select(x_known, 0.0, is_blocked), t_hit);
    // Immediately behind the surface the field is below zero.
    march.t = select(span.x, t_hit + 0.5 * march.least_step, is_blocked);
    let is_whole_disc = beam.is_coarse == 0u;
    var rounds = 0u;
    loop {
        // Steps to the next point at which the surface may be nearer than the known edge.
        var p = vec3f(0.0);
        var distance = 0.0;
        var radius = 0.0;
        var is_near = false;
        while march.is_on && rounds < MAX_CONE_STEPS {
            rounds++;
            p = ray.origin + march.t * ray.direction;
            radius = beam.slope * march.t;
            distance = field_distance(field, p);
            if is_blocked && distance >= 0.0 { march.is_on = false; }
            is_near = march.is_on && (distance * stretch < march.nearest.x * radius || is_blocked);
            if is_near || !march.is_on { break; }
            advance(&march, distance, radius);
        }
        if !is_near { break; }
        visits++;
        var local = distance;
        if !is_blocked { local = max(field_guess(field, p, distance), 0.0); }
        let clear = across(index, local, p);
        let x = clear / radius;
        if x < march.nearest.x { march.nearest = vec2f(x, select(march.nearest.y, march.t, is_blocked)); }
        if x <= -1.0 || (!is_blocked && (x <= 0.0 || (x < 1.0 && is_whole_disc))) { break; }
        advance(&march, distance, radius);
    }
    steps += rounds;
    if !is_blocked && !march.is_past { march.nearest.y = 0.0; }
    return march.nearest;
}

// Margin for the rounding of an edge's position, in radii.
const RIM_ROUNDING: f32 = 1e-5;

// The visible fraction of a disc when an edge passes at x radii from its centre.
fn visible_share(edge: f32) -> f32 {
    let x = clamp((1.0 + RIM_ROUNDING) * edge, -1.0, 1.0);
    if abs(x) == 1.0 { return 0.5 + 0.5 * x; }
    let s = x * x;
    return 0.5 + x * (0.63661975 - s * (0.1061 + s * (0.01592 + s * 0.0146)));
}

// ---- cones as thin rays, twin of src/scene/light/ray_bundle.rs

const THIN_RAYS: u32 = 8u;

// Transmitted fractions of the rays of a cone.
struct RayBundle {
    shares: array<f32, THIN_RAYS>,
    // Whether an object was near enough to be tested.
    is_tested: bool,
}

fn all_thin_rays() -> RayBundle {
    var thin: RayBundle;
    for (var i = 0u; i < THIN_RAYS; i++) { thin.shares[i] = 1.0; }
    return thin;
}

// Whether a cone may touch an instance, by the ball around its surface.
fn may_intersect(index: u32, beam: Beam) -> bool {
    let to = &instances[index];
    let ray = ray_in_field(index, beam);
    // Under non-uniform scale a cone is widest where the scene is stretched least.
    let slope = beam.slope / (length(local_direction(index, beam.direction)) * (*to).least_stretch);
    let way = 0.5 * ((*to).surface_lower + (*to).surface_upper) - ray.origin;
    let direction = normalize(ray.direction);
    let along = dot(way, direction);
    let aside = length(way - along * direction);
    return aside - slope * along <= (*to).surface_radius * sqrt(1.0 + slope * slope);
}

// The ray of a cone to point `i` of its section, spread evenly.
fn thin_ray(beam: Beam, i: u32) -> Beam {
    let d = beam.direction;
    let axes = axes_of(d);
    let radius = beam.slope * sqrt((f32(i) + 0.5) / f32(THIN_RAYS));
    let angle = f32(i) * GOLDEN_ANGLE;
    let way = d + radius * (cos(angle) * axes.right + sin(angle) * axes.up);
    var ray = beam;
    ray.slope = 0.0;
    ray.direction = normalize(way);
    return ray;
}

// Multiplies the rays that hit an instance by its transmitted fraction.
fn block(thin: ptr<function, RayBundle>, occluder: Occluder, beam: Beam) {
    let to = &instances[occluder.index];
    (*thin).is_tested = true;
    for (var i = 0u; i < THIN_RAYS; i++) {
        steps++;
        let ray = ray_in_field(occluder.index, thin_ray(beam, i));
        let span = clip(ray.origin, ray.direction, (*to).surface_lower, (*to).surface_upper, occluder.part);
        if (*thin).shares[i] == 0.0 || span.x > span.y { continue; }
        let start = ray.origin + span.x * ray.direction;
        if thin_hit(fields[(*to).field], start, ray.direction, span.y - span.x) >= 0.0 {
            (*thin).shares[i] *= 1.0 - (*to).opacity;
        }
    }
}

fn thin_share(thin: ptr<function, RayBundle>) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < THIN_RAYS; i++) { sum += (*thin).shares[i]; }
    return sum / f32(THIN_RAYS);
}

// Fraction of a cone's section that passes, and whether it is proven.
fn cone_share(beam: Beam, with_edges: bool) -> vec2f {
    var share = 1.0;
    var is_proven = true;
    var x = 1.0;
    var thin = all_thin_rays();
    var walk = begin_walk(beam);
    for (var occluder = next_occluder(&walk, beam); occluder.index != NO_INSTANCE; occluder = next_occluder(&walk, beam)) {
        if HAS_THIN && instances[occluder.index].prefers_rays != 0u {
            if may_intersect(occluder.index, beam) { block(&thin, occluder, beam); }
            continue;
        }
        let opacity = instances[occluder.index].opacity;
        let x_known = select(1.0, x, beam.is_coarse != 0u && opacity >= 1.0);
        let ray = ray_in_field(occluder.index, beam);
        let span = cone_span(occluder, beam, ray, x_known);
        var cone = Cone(1.0, false);
        if span.x <= span.y { cone = cone_past(occluder, beam, ray, span, x_known, with_edges); }
        if needs_edge { return vec2f(0.0); }
        if opacity < 1.0 {
            share *= 1.0 - opacity * (1.0 - visible_share(cone.x));
            is_proven = is_proven && (cone.is_covered || cone.x >= 1.0);
        } else {
            if cone.is_covered { return vec2f(0.0, 1.0); }
            x = min(x, cone.x);
            if x <= -1.0 && beam.is_coarse != 0u { return vec2f(0.0); }
        }
    }
    if HAS_THIN {
        share *= thin_share(&thin);
        is_proven = is_proven && !thin.is_tested;
    }
    return vec2f(share * visible_share(x), select(0.0, 1.0, is_proven && x >= 1.0));
}

// Evaluates thin rays. Rays and cones have separate kernels, because unused code costs time: at the start of a kernel,
// and on software devices in every invocation.
@compute @workgroup_size(64)
fn rays(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    begin_invocation(id);
    steps = 0u;
    is_far = 0u;
    let beam = beams[params.first + id.x];
    let share = ray_share(beam);
    beam_results[beam.owner] = BeamResult(share, 1u, steps, u32(steps < MAX_STEPS), is_far);
}

// Evaluates cones without rays past edges. Most cones need none, and a kernel without those rays is much shorter.
@compute @workgroup_size(64)
fn cones(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    begin_invocation(id);
    steps = 0u;
    is_far = 0u;
    needs_edge = false;
    let beam = beams[params.first + id.x];
    let found = cone_share(beam, false);
    let state = select(u32(steps < MAX_STEPS), NEEDS_EDGE, needs_edge);
    beam_results[beam.owner] = BeamResult(found.x, u32(found.y), steps, state, is_far);
}

// Evaluates the cones that need a ray past an edge.
@compute @workgroup_size(64)
fn edge_cones(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    begin_invocation(id);
    steps = 0u;
    is_far = 0u;
    needs_edge = false;
    let beam = beams[params.first + id.x];
    let found = cone_share(beam, true);
    beam_results[beam.owner] = BeamResult(found.x, u32(found.y), steps, u32(steps < MAX_STEPS), is_far);
}

// ---- lengths inside an instance, twin of src/scene/light/transmission.rs

const LEAST_VOXELS: f32 = 0.125;
const MOST_LENGTH_STEPS: f32 = 1024.0;
const BACK_VOXELS: f32 = 1.0;

// Length inside between two evaluations; a crossing is interpolated linearly. The distance FAR_T before the first
// evaluation counts as outside.
fn length_between(before: vec2f, here: vec2f) -> f32 {
    let step = here.x - before.x;
    if before.y < 0.0 && here.y < 0.0 { return step; }
    if (before.y >= 0.0 && here.y >= 0.0) || before.y >= FAR_T { return 0.0; }
    let share = before.y / (before.y - here.y);
    return step * select(1.0 - share, share, before.y < 0.0);
}

// The length of a ray inside its own instance.
@compute @workgroup_size(64)
fn thicknesses(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    begin_invocation(id);
    var beam = beams[params.first + id.x];
    steps = 0u;
    let enters = dot(beam.normal, beam.direction) < 0.0;
    if enters { beam.bias_voxels = 0.0; }
    let to = &instances[beam.own];
    let field = fields[(*to).field];
    let ray = ray_in_field(beam.own, beam);
    let voxel = 1.0 / length(ray.direction);
    let part = vec2f(select(0.0, -BACK_VOXELS * voxel, enters), beam.t_max);
    let span = clip(ray.origin, ray.direction, (*to).surface_lower, (*to).surface_upper, part);
    var inside = 0.0;
    if span.x <= span.y {
        let pace = 1.0 / length(local_direction(beam.own, beam.direction));
        let least_step = max(LEAST_VOXELS * voxel, (span.y - span.x) / MOST_LENGTH_STEPS);
        // Position along the ray and the distance there.
        var before = vec2f(span.x, FAR_T);
        var t = span.x;
        while steps < MAX_STEPS {
            steps++;
            let here = vec2f(t, field_distance(field, ray.origin + t * ray.direction));
            inside += length_between(before, here);
            if t >= span.y { break; }
            before = here;
            t = min(t + max(abs(here.y) * pace, least_step), span.y);
        }
    }
    beam_results[beam.owner] = BeamResult(inside, 1u, steps, 1u, 0u);
}
