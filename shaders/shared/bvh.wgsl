// The binary tree over triangles and its closest-triangle search. Twin of src/bvh/binary.rs.
//
// One flat loop: each round handles one node, and the triangles of a leaf are unrolled by hand. Software adapters stop
// an invocation after 65,535 rounds of all its loops together, without an error, so the rounds are counted here and a
// search that needs more says so; the caller then redoes it on the CPU.

#import triangle

struct Node {
    min: vec3f,
    // An inner node: the first of its two children. A leaf: its first triangle.
    first: u32,
    max: vec3f,
    // Triangles of a leaf, at most four; zero for an inner node.
    count: u32,
}

@group(0) @binding(1) var<storage, read> nodes: array<Node>;
@group(0) @binding(2) var<storage, read> triangles: array<Triangle>;

// Below the 65,535 of software adapters.
const MAX_ROUNDS: u32 = 65000u;
// Waiting nodes; the tree is never deeper (checked when it is built).
const MAX_STACK: u32 = 96u;
const NO_TRIANGLE: u32 = 0xffffffffu;
// Larger than any squared distance in local coordinates. WGSL has no infinity.
const FAR: f32 = 3.0e38;

struct Nearest {
    squared: f32,
    // Index into `triangles`.
    slot: u32,
    // False if the rounds ran out: then `squared` is only an upper bound.
    complete: bool,
}

fn box_distance_squared(node: Node, p: vec3f) -> f32 {
    let outside = max(max(node.min - p, p - node.max), vec3f(0.0));
    return dot(outside, outside);
}

fn consider(slot: u32, p: vec3f, best: ptr<function, Nearest>) {
    let squared = triangle_distance_squared(triangles[slot], p);
    if squared < (*best).squared {
        (*best).squared = squared;
        (*best).slot = slot;
    }
}

// The triangle nearest to `p` among those nearer than `start`; `start` itself if there is none.
fn nearest_triangle(p: vec3f, start: Nearest) -> Nearest {
    var best = start;
    best.complete = false;
    var stack: array<u32, MAX_STACK>;
    var top = 0u;
    var current = 0u;
    for (var round = 0u; round < MAX_ROUNDS; round++) {
        let node = nodes[current];
        var descend = false;
        if node.count > 0u {
            if box_distance_squared(node, p) < best.squared {
                consider(node.first, p, &best);
                if node.count > 1u { consider(node.first + 1u, p, &best); }
                if node.count > 2u { consider(node.first + 2u, p, &best); }
                if node.count > 3u { consider(node.first + 3u, p, &best); }
            }
        } else {
            // Go on with the near child, put the far one on the stack.
            let left = box_distance_squared(nodes[node.first], p);
            let right = box_distance_squared(nodes[node.first + 1u], p);
            let right_first = u32(right < left);
            if max(left, right) < best.squared {
                stack[top] = node.first + (1u - right_first);
                top++;
            }
            if min(left, right) < best.squared {
                current = node.first + right_first;
                descend = true;
            }
        }
        if !descend {
            if top == 0u {
                best.complete = true;
                return best;
            }
            top--;
            current = stack[top];
        }
    }
    return best;
}
