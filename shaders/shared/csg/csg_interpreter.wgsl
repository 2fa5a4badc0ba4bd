// The stack machine over the tokens of a shape. It evaluates every shape. Twin of Program::run in
// src/csg/evaluation/program.rs.

#import csg_leaves

// Depth of the stack. The operand that needs the deeper stack is evaluated first, so no shape needs more.
const MAX_STACK: u32 = 32u;

// The vector in `numbers` from `first` on.
fn vector_at(first: u32) -> vec3f {
    return vec3f(numbers[first], numbers[first + 1u], numbers[first + 2u]);
}

// A point in the space inside a warp. Kinds: 0 elongation, 1 twist, 2 bend, 3 the nearest copy.
fn warped(warp: u32, p: vec3f) -> vec3f {
    let q = placed(warp, p);
    let a = leaves[warp].a;
    switch leaves[warp].kind {
        case 0u: { return q - clamp(q, -a.xyz, a.xyz); }
        case 1u: { return turned_about_z(q, -a.x * q.z); }
        case 2u: { return turned_about_z(q, -a.x * q.x); }
        default: {
            let first = leaves[warp].first;
            return nearest_copy(
                q, vector_at(first), vector_at(first + 3u), vector_at(first + 6u), vector_at(first + 9u),
                vector_at(first + 12u)
            );
        }
    }
}

// Divisor for distances inside a warp.
fn stretch(warp: u32, p: vec3f) -> f32 {
    let q = placed(warp, p);
    return 1.0 + leaves[warp].b.x * max(length(q.xy), leaves[warp].b.y);
}

fn joined(joint: u32, a: f32, b: f32) -> f32 {
    let kind = numbers[joint];
    let width = numbers[joint + 1u];
    if kind == 0.0 { return sharp_union(a, b, width); }
    if kind == 1.0 { return smooth_union(a, b, width); }
    return chamfer_union(a, b, width);
}

fn combined(op: u32, joint: u32, below: f32, top: f32) -> f32 {
    let is_swapped = numbers[joint + 2u] == 1.0;
    let a = select(below, top, is_swapped);
    let b = select(top, below, is_swapped);
    switch op {
        case TOKEN_UNION: { return joined(joint, a, b); }
        case TOKEN_INTERSECTION: { return -joined(joint, -a, -b); }
        case TOKEN_DIFFERENCE: { return -joined(joint, -a, b); }
        default: {
            let either = joined(joint, a, b);
            let both = -joined(joint, -a, -b);
            return -joined(joint, -either, both);
        }
    }
}

// The field of a list of tokens at a point, local units.
fn csg_distance(p: vec3f, first: u32, count: u32) -> f32 {
    var values: array<f32, MAX_STACK>;
    var positions: array<vec3f, MAX_WARPS>;
    var at = p;
    var top = 0u;
    var warps = 0u;
    for (var i = 0u; i < count && has_rounds(); i++) {
        rounds++;
        let token = tokens[first + i];
        let index = token & TOKEN_INDEX;
        let what = token >> TOKEN_SHIFT;
        switch what {
            case TOKEN_LEAF: {
                values[top] = leaf_distance(index, at);
                top++;
            }
            case TOKEN_OFFSET: { values[top - 1u] -= numbers[index]; }
            case TOKEN_SHELL: { values[top - 1u] = abs(values[top - 1u]) - numbers[index]; }
            case TOKEN_TIMES: { values[top - 1u] *= numbers[index]; }
            case TOKEN_COMPLEMENT: { values[top - 1u] = -values[top - 1u]; }
            case TOKEN_ENTER: {
                positions[warps] = at;
                warps++;
                at = warped(index, at);
            }
            case TOKEN_LEAVE: {
                warps--;
                at = positions[warps];
                values[top - 1u] /= stretch(index, at);
            }
            default: {
                top--;
                values[top - 1u] = combined(what, index, values[top - 1u], values[top]);
            }
        }
    }
    return values[0];
}
