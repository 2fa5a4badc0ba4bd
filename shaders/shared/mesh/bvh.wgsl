// The search for the triangle nearest to a point. Twin of src/bvh/nearest/closest.rs.
//
// The search is one flat loop. A round tests one triangle of the current leaf, or opens one node.

#import tree
#import triangle

@group(0) @binding(2) var<storage, read> triangles: array<Triangle>;

struct Nearest {
    squared: f32,
    // Index of the triangle in `triangles`.
    slot: u32,
    // False if the rounds ran out. Then `squared` is only an upper bound.
    complete: bool,
}

fn box_distance_squared(low: vec3f, high: vec3f, p: vec3f) -> f32 {
    let outside = max(max(low - p, p - high), vec3f(0.0));
    return dot(outside, outside);
}

// The triangle nearest to `p` among those nearer than `start`. Returns `start` if there is none.
fn nearest_triangle(p: vec3f, start: Nearest) -> Nearest {
    var best = start;
    best.complete = false;
    var stack: array<u32, MAX_STACK>;
    var stack_squared: array<f32, MAX_STACK>;
    var top = 0u;
    var current = 0u;
    for (var round = 0u; round < MAX_ROUNDS; round++) {
        if current == NOTHING {
            // Pops the stack. Most waiting children are farther than the best triangle by now, so two are tested.
            if top > 1u && stack_squared[top - 1u] >= best.squared { top--; }
            if top == 0u {
                best.complete = true;
                return best;
            }
            top--;
            if stack_squared[top] < best.squared { current = stack[top]; }
        }
        if current == NOTHING { continue; }
        if current >= LEAF {
            let slot = current & LEAF_FIRST;
            let squared = triangle_distance_squared(triangles[slot], p);
            if squared < best.squared {
                best.squared = squared;
                best.slot = slot;
            }
            // The remaining triangles of the leaf are a leaf again.
            current = select(NOTHING, current - LEAF_ONE + 1u, current - LEAF >= LEAF_ONE);
        } else {
            // Continues with the near child and pushes the far one.
            let node = nodes[current];
            let left = box_distance_squared(node.left_min, node.left_max, p);
            let right = box_distance_squared(node.right_min, node.right_max, p);
            let near = select(node.left, node.right, right < left);
            if max(left, right) < best.squared {
                stack[top] = select(node.right, node.left, right < left);
                stack_squared[top] = max(left, right);
                top++;
            }
            current = select(NOTHING, near, min(left, right) < best.squared);
        }
    }
    return best;
}
