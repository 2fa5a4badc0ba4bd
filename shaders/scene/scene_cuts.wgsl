// Finds a cut of the scene's tree for each few consecutive cones: the nodes at which their searches start. Neighbours
// in the list of cones are mostly neighbours in the picture, so one search through the upper part of the tree serves
// all of them.
//
// A cut has the leaves that any of the cones may enter, in the order of a search from the root. Where they do not fit,
// it has inner nodes. A search from a cut finds the same instances in the same order as one from the root.

#import scene_tree

struct CutParams {
    first: u32,
    // Number of cuts.
    count: u32,
    // Number of cones.
    cones: u32,
    pad_0: u32,
}

@group(0) @binding(0) var<uniform> params: CutParams;
@group(0) @binding(2) var<storage, read_write> cuts: array<u32>;
@group(0) @binding(7) var<storage, read> beams: array<Beam>;

// Margins for rounding: relative, and in scene units.
const MORE: f32 = 1.0001;
const MARGIN: f32 = 1e-6;

@compute @workgroup_size(64)
fn tree_cuts(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    begin_invocation(id);
    let first = id.x * CUT_BEAMS;
    let end = min(first + CUT_BEAMS, params.cones);
    // The bound of the first cone is used, widened: each point of another one's axis is within `aside` of the point of
    // the first axis at the same fraction of the length.
    let one = beams[first];
    var aside = vec3f(0.0);
    var slope = one.slope;
    var t_max = one.t_max;
    var is_parallel = true;
    for (var i = first + 1u; i < end; i++) {
        let other = beams[i];
        aside = max(aside, abs(other.p - one.p));
        if other.t_max < FAR_T {
            aside = max(aside, abs(other.p + other.t_max * other.direction - one.p - one.t_max * one.direction));
        }
        is_parallel = is_parallel && all(other.direction == one.direction) && other.t_max == one.t_max;
        slope = max(slope, other.slope);
        t_max = max(t_max, other.t_max);
    }
    var at = CUT_NODES * id.x;
    let last = at + CUT_NODES;
    // Lines without end have no common fraction of their lengths.
    if t_max >= FAR_T && !is_parallel {
        cuts[at] = 0u;
        cuts[at + 1u] = NO_NODE;
        return;
    }
    // The cones that divide a disc extend beyond it: the axes reach up to its rim, their slope is a quarter of the
    // disc's, and they are longer by the secant of their angle to its axis.
    slope *= 1.0 + 0.25 * sqrt(1.0 + slope * slope);
    var stack: array<u32, MAX_DEPTH>;
    var top = 0u;
    var node = 0u;
    while node != NO_NODE {
        let it = nodes[node];
        let far = reach(one.p, it.min, it.max) + length(aside);
        let grown = MORE * (aside + min(slope / (1.0 - min(slope, 0.9)) * far, slope * t_max)) + MARGIN;
        let span = clip(one.p, one.direction, it.min - grown, it.max + grown, vec2f(0.0, one.t_max));
        let is_met = span.x <= span.y * MORE;
        // Each node that waits will take a place.
        let fits = at + top + 2u <= last;
        if is_met && it.second == 0u && fits {
            stack[top] = it.first;
            top++;
            node = it.first + 1u;
            continue;
        }
        if is_met {
            cuts[at] = node;
            at++;
        }
        if top == 0u { break; }
        top--;
        node = stack[top];
    }
    if at < last { cuts[at] = NO_NODE; }
}
