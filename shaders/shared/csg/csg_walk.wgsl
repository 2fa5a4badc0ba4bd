// The first hit of a ray with a shape, through the boxes of its parts, front to back. Twin of src/csg/parts/trace.rs.
//
// The importing kernel defines `boxes`, with the nodes of the tree before the boxes of the parts; `node_count`;
// `longest_step`, which is 1 / largest Lipschitz constant of a part; and `count_evaluation`, which counts the
// evaluation of a part.

#import csg_chord
#import csg_needs
#import csg_part
#import csg_root

// A node of the tree over boxes, or the box of a part.
//             | inner node         | leaf                     | box of a part
//   `first`   | left child         | first box                | first token of the part
//   `count`   | 0                  | number of boxes          | number of tokens
// The right child of an inner node is `first + 1`.
struct CsgBox {
    lower: vec3f,
    first: u32,
    upper: vec3f,
    count: u32,
    // 0: sphere traced by the interpreter. FORM_UNION or FORM_CHORDS: closed form. From 3: function `form - 3` of a
    // specialised kernel.
    form: u32,
    // Index of the part's first parameter in `numbers`, for a compiled field.
    parameters: u32,
    pad_0: u32,
    pad_1: u32,
}

const MAX_WAITING: u32 = 64u;
const NO_BOX: u32 = 0xffffffffu;

struct PartRay {
    origin: vec3f,
    direction: vec3f,
    inverse: vec3f,
}

struct PartHit {
    t: f32,
    cell: u32,
    is_hit: bool,
}

fn part_along(ray: PartRay, t: f32, cell: u32) -> f32 {
    count_evaluation(cell);
    return part_at(ray.origin + t * ray.direction, cell);
}

fn part_at(p: vec3f, cell: u32) -> f32 {
    return part_distance(p, boxes[cell].form, boxes[cell].first, boxes[cell].count, boxes[cell].parameters);
}

// Whether a part is intersected in closed form.
fn is_closed(form: u32) -> bool {
    return HAS_CHORDS && (!MARCHES || form == FORM_UNION || form == FORM_CHORDS);
}

fn part_ray(origin: vec3f, direction: vec3f) -> PartRay {
    return PartRay(origin, direction, 1.0 / select(direction, vec3f(STILL), abs(direction) < vec3f(STILL)));
}

// The interval (t_in, t_out) of a ray inside a box; a miss returns t_in >= t_out. A ray within a face belongs to the
// box above the face.
fn part_span(ray: PartRay, cell: u32, t_max: f32) -> vec2f {
    let a = (boxes[cell].lower - ray.origin) * ray.inverse;
    let b = (boxes[cell].upper - ray.origin) * ray.inverse;
    let low = min(a, b);
    let high = max(a, b);
    return vec2f(max(max(low.x, low.y), max(low.z, 0.0)), min(min(high.x, high.y), min(high.z, t_max)));
}

// The first t on [t_in, t_out) at which the ray is inside the part of a box, or -1.
fn root_in_part(ray: PartRay, cell: u32, t_in: f32, t_out: f32) -> f32 {
    let form = boxes[cell].form;
    if !is_closed(form) { return march_part(ray, cell, t_in, t_out); }
    count_evaluation(cell);
    let is_union = form == FORM_UNION;
    return first_inside(ray.origin, ray.direction, boxes[cell].first, boxes[cell].count, is_union, t_in, t_out);
}

// The first root of a sphere-traced part on [t_in, t_out), or -1.
fn march_part(ray: PartRay, cell: u32, t_in: f32, t_out: f32) -> f32 {
    var search = search_from(t_in);
    var state = SEARCHING;
    for (var i = 0u; i < MAX_MARCH_STEPS && state == SEARCHING && has_rounds(); i++) {
        rounds++;
        state = search_on(&search, part_along(ray, search.t, cell), longest_step(), t_out);
    }
    return select(-1.0, search.t, state == FOUND && (search.t < t_out || search.t == t_in));
}

// The first hit on [0, t_max), or any hit.
fn trace_parts(ray: PartRay, t_max: f32, any: bool) -> PartHit {
    var best = PartHit(t_max, 0u, false);
    // Nodes and boxes still to visit. The nearest of the latest children lies on top.
    var waiting: array<u32, MAX_WAITING>;
    var waiting_t: array<f32, MAX_WAITING>;
    var count = 0u;
    let root_span = part_span(ray, 0u, t_max);
    if node_count() > 0u && root_span.x < root_span.y {
        waiting[0] = 0u;
        waiting_t[0] = root_span.x;
        count = 1u;
    }
    while count > 0u && has_rounds() {
        // Descends to a box. The expensive intersection follows this loop, so that it is not evaluated per node.
        var cell = NO_BOX;
        while count > 0u && cell == NO_BOX && has_rounds() {
            rounds++;
            count--;
            let node = waiting[count];
            if waiting_t[count] >= best.t { continue; }
            if node >= node_count() {
                cell = node;
                continue;
            }
            // The two children of an inner node, or the few boxes of a leaf.
            let few = boxes[node].count;
            let first = boxes[node].first + select(node_count(), 0u, few == 0u);
            let bottom = count;
            for (var i = 0u; i < select(few, 2u, few == 0u) && count < MAX_WAITING; i++) {
                rounds++;
                let t = part_span(ray, first + i, best.t);
                if t.x >= t.y { continue; }
                // Inserts the entry in order of distance.
                var place = count;
                while place > bottom && waiting_t[place - 1u] < t.x {
                    rounds++;
                    waiting[place] = waiting[place - 1u];
                    waiting_t[place] = waiting_t[place - 1u];
                    place--;
                }
                waiting[place] = first + i;
                waiting_t[place] = t.x;
                count++;
            }
        }
        if cell == NO_BOX { break; }
        let t = part_span(ray, cell, best.t);
        let found = root_in_part(ray, cell, t.x, t.y);
        if found >= 0.0 && found < best.t {
            best = PartHit(found, cell - node_count(), true);
            if any { return best; }
        }
    }
    return best;
}
