// The search for the occluders along a beam: instances in a tree, and the levels of the far field. Twin of the searches
// in src/scene/light/shadow.rs, occluder.rs and far_field.rs.

#import scene_cases
#import scene_objects
#import scene_tree

struct BeamParams {
    first: u32,
    count: u32,
    // Index of the finest level of the far field among the instances; the other levels follow. NO_INSTANCE without a
    // far field.
    far: u32,
    far_levels: u32,
    // 1 if no instance must be evaluated beyond the far field's distance.
    far_holds_all: u32,
    // Distance at which the far field starts. Negative: FAR_VOXELS voxels of the level in which a beam starts.
    far_distance: f32,
    pad_0: u32,
    pad_1: u32,
}

@group(0) @binding(0) var<uniform> params: BeamParams;
// Cuts of the tree, CUT_NODES words each: nodes, and NO_NODE behind the last one if there are fewer.
@group(0) @binding(2) var<storage, read> cuts: array<u32>;

// Margin of boxes for rounding, scene units. The nodes in src/scene/content/tree.rs have the same margin.
const BOX_MARGIN: f32 = 2e-6;

const FAR_VOXELS: f32 = 8.0;
const NO_INSTANCE: u32 = 0xffffffffu;
const NOWHERE: vec2f = vec2f(1.0, 0.0);

var<private> is_far: u32;

// Number of nodes that the invocation visited, and of edges that it evaluated: together with `steps`, at most
// MAX_STEPS. `steps` does not include them: the number of nodes depends on the cut, and the order of the cones in
// memory, from which cuts are made, differs between runs.
var<private> visits: u32;

// ---- boxes

fn intersects(beam: Beam, low: vec3f, high: vec3f, t_max: f32) -> bool {
    let grown = widest(beam.p, beam.slope, low, high, t_max);
    let span = clip(beam.p, beam.direction, low - grown, high + grown, vec2f(0.0, t_max));
    return span.x <= span.y * 1.000001;
}

// ---- the far field, twin of src/scene/light/far_field.rs

// The split of a beam into intervals for the instances and for the far field.
struct Split {
    // End of the interval for the instances.
    near: f32,
    // Start of the second interval for the instances; FAR_T if there is none.
    rest: f32,
    // Interval for the far field; empty if from > to.
    far: vec2f,
}

fn far_distance_from(p: vec3f) -> f32 {
    if params.far_distance + f32(zero) >= 0.0 { return params.far_distance; }
    let last = params.far + params.far_levels - 1u + zero;
    for (var level = params.far; level < last; level++) {
        let to = &instances[level];
        if all(p >= (*to).box_min) && all(p <= (*to).box_max) { return FAR_VOXELS * (*to).voxel; }
    }
    return FAR_VOXELS * instances[last].voxel;
}

fn split_of(beam: Beam) -> Split {
    let whole = Split(beam.t_max, FAR_T, NOWHERE);
    if !HAS_FAR || params.far + zero == NO_INSTANCE || beam.cut == ROOT_WITHOUT_OWN { return whole; }
    let to = &instances[params.far + params.far_levels - 1u];
    let grown = widest(beam.p, beam.slope, (*to).box_min, (*to).box_max, beam.t_max);
    let part = vec2f(far_distance_from(beam.p), beam.t_max);
    let span = clip(beam.p, beam.direction, (*to).box_min - grown, (*to).box_max + grown, part);
    if span.x >= span.y { return whole; }
    let needs_rest = span.y < beam.t_max && params.far_holds_all + zero == 0u;
    return Split(span.x, select(FAR_T, span.y, needs_rest), span);
}

// The far interval of a beam inside the box of a level.
fn part_in_level(level: u32, beam: Beam, far: vec2f) -> vec2f {
    if level == params.far + params.far_levels - 1u { return far; }
    return clip(beam.p, beam.direction, instances[level].box_min, instances[level].box_max, far);
}

// The piece of the interval `part` before the interval of the next finer level (`which` = 0) or behind it (1).
fn piece_of(which: u32, part: vec2f, finer: vec2f) -> vec2f {
    if finer.x > finer.y { return select(NOWHERE, part, which == 0u); }
    return select(vec2f(finer.y, part.y), vec2f(part.x, finer.x), which == 0u);
}

// ---- instances

fn ray_in_field(index: u32, beam: Beam) -> FieldRay {
    let to = &instances[index];
    var p = beam.p;
    if index == beam.own {
        let n = beam.normal;
        let voxel = length(vec3f(dot((*to).normal_x, n), dot((*to).normal_y, n), dot((*to).normal_z, n)));
        p += beam.bias_voxels * voxel * n;
    }
    let at = vec4f(p, 1.0);
    var ray: FieldRay;
    ray.origin = vec3f(dot((*to).field_x, at), dot((*to).field_y, at), dot((*to).field_z, at));
    ray.direction = field_direction(index, beam.direction);
    return ray;
}

// An occluder on an interval of a beam: an instance, or a level of the far field.
struct Occluder {
    index: u32,
    part: vec2f,
    // Length to skip if the interval begins inside it.
    skip: f32,
}

// A search along a beam: through the tree, then through the levels of the far field.
struct Walk {
    // Nodes to visit: `node`, the nodes of the stack, and the nodes of the cut from `next_in_cut` on.
    node: u32,
    stack: array<u32, MAX_DEPTH>,
    top: u32,
    next_in_cut: u32,
    end_of_cut: u32,
    // The rest of a leaf: instances, or NO_INSTANCE.
    next: u32,
    second: u32,
    split: Split,
    // Length of the search through the tree.
    reach: f32,
    // An instance that must be evaluated again on the second interval of the beam.
    again: u32,
    // Number of visited pieces of levels, two per level, and the interval of the previous level.
    pieces: u32,
    finer: vec2f,
}

fn begin_walk(beam: Beam) -> Walk {
    var walk: Walk;
    let has_cut = beam.cut < ROOT_WITHOUT_OWN;
    walk.node = select(0u, NO_NODE, has_cut);
    walk.next_in_cut = select(0u, CUT_NODES * beam.cut, has_cut);
    walk.end_of_cut = select(0u, CUT_NODES * beam.cut + CUT_NODES, has_cut);
    walk.next = NO_INSTANCE;
    walk.second = NO_INSTANCE;
    walk.split = split_of(beam);
    let has_far = walk.split.far.x <= walk.split.far.y;
    let is_near = has_far && walk.split.rest >= FAR_T && params.far_holds_all + zero != 0u;
    walk.reach = select(beam.t_max, walk.split.near, is_near);
    walk.again = NO_INSTANCE;
    walk.finer = NOWHERE;
    return walk;
}

// The next occluder whose box the beam enters; NO_INSTANCE at the end.
fn next_occluder(walk: ptr<function, Walk>, beam: Beam) -> Occluder {
    if HAS_FAR && (*walk).again != NO_INSTANCE {
        let again = Occluder((*walk).again, vec2f((*walk).split.rest, beam.t_max), 0.0);
        (*walk).again = NO_INSTANCE;
        return again;
    }
    loop {
        // Nodes and instances have loops of their own, because software drivers execute all branches in each round of a
        // loop.
        while (*walk).next == NO_INSTANCE && steps + visits < MAX_STEPS {
            if (*walk).node == NO_NODE {
                if (*walk).top > 0u {
                    (*walk).top--;
                    (*walk).node = (*walk).stack[(*walk).top];
                } else if (*walk).next_in_cut < (*walk).end_of_cut {
                    (*walk).node = cuts[(*walk).next_in_cut];
                    (*walk).next_in_cut++;
                }
                if (*walk).node == NO_NODE {
                    // Words behind the last node of a cut are undefined.
                    (*walk).end_of_cut = 0u;
                    break;
                }
            }
            visits++;
            let node = nodes[(*walk).node];
            (*walk).node = NO_NODE;
            if !intersects(beam, node.min, node.max, (*walk).reach) { continue; }
            if node.second == 0u {
                (*walk).stack[(*walk).top] = node.first;
                (*walk).top++;
                (*walk).node = node.first + 1u;
            } else {
                (*walk).next = node.first;
                (*walk).second = select(node.second - 1u, NO_INSTANCE, node.second - 1u == node.first);
            }
        }
        let index = (*walk).next;
        if index == NO_INSTANCE { break; }
        (*walk).next = (*walk).second;
        (*walk).second = NO_INSTANCE;
        let to = &instances[index];
        let opacity = (*to).opacity;
        if (*to).casts_shadow == CASTS_NOTHING || opacity == 0.0 { continue; }
        // The CPU traces the triangles of meshes for rays.
        if (*to).casts_shadow == CASTS_FOR_CONES && beam.slope == 0.0 { continue; }
        // The box of a leaf contains two instances.
        if !intersects(beam, (*to).box_min - BOX_MARGIN, (*to).box_max + BOX_MARGIN, (*walk).reach) { continue; }
        if beam.cut == ROOT_WITHOUT_OWN && index == beam.own { continue; }
        // The far field contains opaque solids only.
        let is_whole = opacity < 1.0 || (HAS_THIN && instances[index].prefers_rays != 0u);
        if is_whole { return Occluder(index, vec2f(0.0, beam.t_max), 0.0); }
        if HAS_FAR && (*walk).split.rest < FAR_T { (*walk).again = index; }
        return Occluder(index, vec2f(0.0, (*walk).split.near), 0.0);
    }
    // The CPU evaluates a beam whose search did not end.
    if steps + visits >= MAX_STEPS { steps = MAX_STEPS; }
    return next_level(walk, beam);
}

// The next level of the far field on its next piece of the beam.
fn next_level(walk: ptr<function, Walk>, beam: Beam) -> Occluder {
    let far = (*walk).split.far;
    if !HAS_FAR || far.x > far.y { return Occluder(NO_INSTANCE, NOWHERE, 0.0); }
    is_far = 1u;
    while (*walk).pieces < 2u * params.far_levels + zero {
        let level = params.far + (*walk).pieces / 2u;
        let which = (*walk).pieces % 2u;
        (*walk).pieces++;
        let part = part_in_level(level, beam, far);
        let piece = piece_of(which, part, (*walk).finer);
        if which == 1u && part.x <= part.y { (*walk).finer = part; }
        if piece.x < piece.y {
            return Occluder(level, piece, select(0.0, instances[level].voxel, piece.x == far.x));
        }
    }
    return Occluder(NO_INSTANCE, NOWHERE, 0.0);
}

// The t at which a beam enters an occluder, or -1.
fn hit_of(occluder: Occluder, ray: FieldRay) -> f32 {
    let to = &instances[occluder.index];
    let field = fields[(*to).field];
    var part = occluder.part;
    var found = -1.0;
    // A hit at the start of a level of the far field is skipped, and a second round searches behind it. The loop has
    // one march, because drivers inline functions.
    for (var i = 0u; i < select(1u, 2u, HAS_FAR); i++) {
        let span = clip(ray.origin, ray.direction, (*to).surface_lower, (*to).surface_upper, part);
        if span.x > span.y { return -1.0; }
        let hit = field_hit(field, ray.origin + span.x * ray.direction, ray.direction, span.y - span.x);
        if hit < 0.0 { return -1.0; }
        found = hit + span.x;
        if found != part.x || occluder.skip == 0.0 { break; }
        part.x += occluder.skip;
    }
    return found;
}
