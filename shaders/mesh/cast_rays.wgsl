// Finds the triangles that each ray of a list may hit. Twin of src/bvh/rays/cast.rs.
//
// The kernel applies the tests of src/bvh/rays/ray_lanes.rs, with bounds on the rounding of WGSL, which may round a
// result to either neighbour and may fuse a product with a sum. The tests never reject a hit. A hit is certain if no
// such rounding can undo it. The CPU computes the hits of the triangles in float64, so the results do not depend on
// this search.

#import tree

struct CastParams {
    first: u32,
    count: u32,
    // FIRST, ANY or ALL.
    mode: u32,
    pad_0: u32,
}

// A ray in local coordinates. Its `t` counts from `origin` in the scaled direction.
struct CastRay {
    // Position at which the ray enters the box of the mesh.
    origin: vec3f,
    // Largest t of a hit; MISSED or UNSUITED, which are negative, if the device must not search.
    limit: f32,
    // The direction, scaled so that its largest component is 1 or -1.
    direction: vec3f,
    // Axis of that component.
    axis: u32,
    // Reciprocals of the components, of magnitude 1e30 at most.
    inverse: vec3f,
    pad_0: u32,
}

struct Corners {
    a: vec3f,
    face: u32,
    b: vec3f,
    pad_0: u32,
    c: vec3f,
    pad_1: u32,
}

@group(0) @binding(0) var<storage, read> params: CastParams;
@group(0) @binding(2) var<storage, read> triangles: array<Corners>;
@group(0) @binding(3) var<storage, read> rays: array<CastRay>;
// Two vectors for each ray: up to eight faces in order of their smallest t, then NOTHING. The first component may be
// UNDECIDED or CERTAIN.
@group(0) @binding(4) var<storage, read_write> faces: array<vec4u>;

// Relative rounding of the t at which a ray leaves a box.
const LEAVE_GROWTH: f32 = 1.000001f;

// Four faces in ascending order of the smallest t at which the ray may hit them.
struct Candidates {
    low: vec4f,
    face: vec4u,
}

// Candidates after an insertion, and the entry that no longer fits.
struct Insertion {
    kept: Candidates,
    low: f32,
    face: u32,
}

fn insert(old: Candidates, low: f32, face: u32) -> Insertion {
    let is_after = vec4f(low) < old.low;
    let is_previous_after = vec4<bool>(false, is_after.xyz);
    let moved_low = select(vec4f(low), vec4f(0.0, old.low.xyz), is_previous_after);
    let moved_face = select(vec4u(face), vec4u(0u, old.face.xyz), is_previous_after);
    let kept = Candidates(select(old.low, moved_low, is_after), select(old.face, moved_face, is_after));
    return Insertion(kept, select(low, old.low.w, is_after.w), select(face, old.face.w, is_after.w));
}

// The t at which the ray of these values enters and leaves a box.
fn box_interval(low: vec3f, high: vec3f, enter_origin: vec3f, leave_origin: vec3f, inverse: vec3f) -> vec2f {
    let first = (low - enter_origin) * inverse;
    let second = (high - leave_origin) * inverse;
    let enter = min(first, second);
    let leave = max(first, second);
    return vec2f(max(max(enter.x, enter.y), max(enter.z, 0.0)), min(leave.x, min(leave.y, leave.z)));
}

struct TriangleHit {
    // Interval that contains the t of a hit.
    low: f32,
    high: f32,
    may_hit: bool,
    // Whether the ray passes through the inside of the triangle.
    is_through: bool,
}

// Tests a triangle in the space that is sheared along the ray; see src/bvh/rays/watertight.rs. `along` is the unit
// vector of the axis `axis`, in the direction of the ray.
fn triangle_hit(triangle: Corners, ray: CastRay, along: vec3f) -> TriangleHit {
    let a = triangle.a - ray.origin;
    let b = triangle.b - ray.origin;
    let c = triangle.c - ray.origin;
    let t = vec3f(dot(a, along), dot(b, along), dot(c, along));
    // The component along the axis is zero, and so are two components of each cross product.
    let p = a - ray.direction * t.x;
    let q = b - ray.direction * t.y;
    let r = c - ray.direction * t.z;
    let edges = vec3f(dot(cross(r, q), along), dot(cross(p, r), along), dot(cross(q, p), along));

    let largest = max(abs(p), max(abs(q), abs(r)));
    let size = max(largest.x, max(largest.y, largest.z));
    let slack = size * (4.0 * SHEAR_ROUNDING + PRODUCT_ROUNDING * size);
    let least = min(edges.x, min(edges.y, edges.z));
    let most = max(edges.x, max(edges.y, edges.z));
    let sum = edges.x + edges.y + edges.z;

    var hit: TriangleHit;
    hit.may_hit = least >= -slack || most <= slack;
    hit.is_through = least > slack || most < -slack;
    hit.low = min(t.x, min(t.y, t.z));
    hit.high = max(t.x, max(t.y, t.z));
    // The weights of the corners are edges / sum. The slack changes a weight w by (1 + 3 |w|) slack / (|sum| - 3 slack)
    // at most. The weights are between -1/16 and 9/8 here, so all three together change by less than 9 slack / |sum|,
    // and t by half of that times its range over the corners.
    if abs(sum) > 16.0 * slack {
        let middle = t.x + (edges.y * (t.y - t.x) + edges.z * (t.z - t.x)) / sum;
        let reach = 5.0 * slack / abs(sum) * (hit.high - hit.low);
        hit.low = max(hit.low, middle - reach);
        hit.high = min(hit.high, middle + reach);
    }
    hit.low -= T_MARGIN;
    hit.high += T_MARGIN;
    return hit;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    let row = params.first + id.x;
    let ray = rays[row];
    let along = select(vec3f(0.0), sign(ray.direction), vec3u(ray.axis) == vec3u(0u, 1u, 2u));
    let enter_origin = ray.origin + BOX_MARGIN;
    let leave_origin = ray.origin - BOX_MARGIN;
    var near = Candidates(vec4f(FAR_T), vec4u(NOTHING));
    var far = near;
    // Smallest t of the candidates that did not fit.
    var dropped = FAR_T;
    // No result has a larger t.
    var limit = ray.limit;
    var is_complete = ray.limit == MISSED;
    var is_certain = false;
    var stack: array<u32, MAX_STACK>;
    var stack_enter: array<f32, MAX_STACK>;
    var top = 0u;
    var current = 0u;
    for (var round = 0u; round < MAX_ROUNDS && limit >= 0.0; round++) {
        if current == NOTHING {
            // Pops the stack. Two children are tested, since a first hit hides most of them.
            if top > 1u && stack_enter[top - 1u] > limit { top--; }
            if top == 0u {
                is_complete = true;
                break;
            }
            top--;
            if stack_enter[top] <= limit { current = stack[top]; }
        }
        if current == NOTHING { continue; }
        if current >= LEAF {
            let triangle = triangles[current & LEAF_FIRST];
            let hit = triangle_hit(triangle, ray, along);
            if hit.may_hit && hit.low <= limit && hit.high >= 0.0 {
                if hit.is_through && hit.low >= 0.0 && hit.high + T_MARGIN <= ray.limit {
                    if params.mode == ANY {
                        is_certain = true;
                        break;
                    }
                    if params.mode == FIRST { limit = min(limit, hit.high); }
                }
                let first = insert(near, hit.low, triangle.face);
                let second = insert(far, first.low, first.face);
                near = first.kept;
                far = second.kept;
                dropped = min(dropped, second.low);
            }
            // The remaining triangles of the leaf are a leaf again.
            current = select(NOTHING, current - LEAF_ONE + 1u, current - LEAF >= LEAF_ONE);
        } else {
            // Continues with the near child and pushes the far one.
            let node = nodes[current];
            let left = box_interval(node.left_min, node.left_max, enter_origin, leave_origin, ray.inverse);
            let right = box_interval(node.right_min, node.right_max, enter_origin, leave_origin, ray.inverse);
            let hits_left = node.left != NOTHING && left.x <= min(left.y, limit) * LEAVE_GROWTH;
            let hits_right = node.right != NOTHING && right.x <= min(right.y, limit) * LEAVE_GROWTH;
            let is_right_nearer = right.x < left.x;
            if hits_left && hits_right {
                stack[top] = select(node.right, node.left, is_right_nearer);
                stack_enter[top] = max(left.x, right.x);
                top++;
                current = select(node.left, node.right, is_right_nearer);
            } else {
                current = select(select(NOTHING, node.right, hits_right), node.left, hits_left);
            }
        }
    }
    var first = select(vec4u(NOTHING), near.face, near.low <= vec4f(limit));
    if is_certain {
        first.x = CERTAIN;
    } else if !is_complete || dropped <= limit {
        first.x = UNDECIDED;
    }
    faces[2u * row] = first;
    faces[2u * row + 1u] = select(vec4u(NOTHING), far.face, far.low <= vec4f(limit));
}
