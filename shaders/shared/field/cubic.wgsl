// Trilinear interpolation in a cell, and the first root of the cubic that it becomes along a ray. Twin of
// src/volume/mod.rs and src/march/cubic.rs.

fn lerp(a: f32, b: f32, fraction: f32) -> f32 {
    return a + (b - a) * fraction;
}

// The value at a point of a cell; `f` is 0 to 1 along every axis.
fn trilinear(c: array<f32, 8>, f: vec3f) -> f32 {
    let y0 = lerp(lerp(c[0], c[1], f.x), lerp(c[2], c[3], f.x), f.y);
    let y1 = lerp(lerp(c[4], c[5], f.x), lerp(c[6], c[7], f.x), f.y);
    return lerp(y0, y1, f.z);
}

// Coefficients (c0, c1, c2, c3) of the trilinear field along the ray p + s direction: c0 + c1 s + c2 s^2 + c3 s^3.
fn cubic_along_ray(c: array<f32, 8>, p: vec3f, direction: vec3f) -> vec4f {
    // Interpolation along x gives four linear functions of s, along y two quadratic ones, along z the cubic.
    let x00 = vec2f(lerp(c[0], c[1], p.x), (c[1] - c[0]) * direction.x);
    let x10 = vec2f(lerp(c[2], c[3], p.x), (c[3] - c[2]) * direction.x);
    let x01 = vec2f(lerp(c[4], c[5], p.x), (c[5] - c[4]) * direction.x);
    let x11 = vec2f(lerp(c[6], c[7], p.x), (c[7] - c[6]) * direction.x);
    let a = x10 - x00;
    let b = x11 - x01;
    let y0 = vec3f(x00.x + a.x * p.y, x00.y + a.y * p.y + a.x * direction.y, a.y * direction.y);
    let y1 = vec3f(x01.x + b.x * p.y, x01.y + b.y * p.y + b.x * direction.y, b.y * direction.y);
    let d = y1 - y0;
    return vec4f(
        y0.x + d.x * p.z,
        y0.y + d.y * p.z + d.x * direction.z,
        y0.z + d.z * p.z + d.y * direction.z,
        d.z * direction.z,
    );
}

fn cubic_value(c: vec4f, s: f32) -> f32 {
    return c.x + s * (c.y + s * (c.z + s * c.w));
}

fn cubic_slope(c: vec4f, s: f32) -> f32 {
    return c.y + s * (2.0 * c.z + s * 3.0 * c.w);
}

// numerator / denominator if the quotient lies in (0, limit), else limit. The division is skipped where it could
// overflow.
fn quotient_below(numerator: f32, denominator: f32, limit: f32) -> f32 {
    let same_sign = (numerator > 0.0 && denominator > 0.0) || (numerator < 0.0 && denominator < 0.0);
    if same_sign && abs(numerator) < limit * abs(denominator) { return numerator / denominator; }
    return limit;
}

const NO_ROOT: f32 = -1.0;

// The root in [start, end], where the cubic falls from above zero to zero or below. Newton's method, with a bisection
// wherever a step leaves the bracket or shrinks too slowly.
fn falling_root(c: vec4f, start: f32, end: f32) -> f32 {
    var low = start;
    var high = end;
    let value_low = cubic_value(c, low);
    var s = low + (high - low) * (value_low / (value_low - cubic_value(c, high)));
    var last_step = high - low;
    for (var i = 0u; i < MAX_NEWTON_STEPS; i++) {
        let value = cubic_value(c, s);
        if value > 0.0 { low = s; } else { high = s; }
        let slope = cubic_slope(c, s);
        var step = 2.0 * last_step;
        if slope < 0.0 { step = -value / slope; }
        let newton = s + step;
        let converges = newton >= low && newton <= high && abs(step) <= 0.5 * last_step;
        let next = select(0.5 * (low + high), newton, converges);
        last_step = abs(next - s);
        s = next;
        if last_step <= SMALLEST_STEP { break; }
    }
    return s;
}

// The first s in [0, s_end] where the cubic is <= 0, or NO_ROOT.
fn first_root(c: vec4f, s_end: f32) -> f32 {
    if c.x <= 0.0 { return 0.0; }
    // Roots of the derivative 3 c3 s^2 + 2 c2 s + c1 without cancellation: q has the sign of -c2.
    let a = 3.0 * c.w;
    let discriminant = c.z * c.z - a * c.y;
    var turns = vec2f(s_end);
    if discriminant > 0.0 {
        let root = sqrt(discriminant);
        let q = select(-root - c.z, root - c.z, c.z < 0.0);
        let first = quotient_below(q, a, s_end);
        let second = quotient_below(c.y, q, s_end);
        turns = vec2f(min(first, second), max(first, second));
    }
    // The first of the three monotone pieces that ends at or below zero contains the root. The search for it has one
    // place in the text, because drivers inline functions.
    var start = 0.0;
    var end = turns.x;
    var has_root = turns.x > start && cubic_value(c, turns.x) <= 0.0;
    if !has_root {
        start = max(start, turns.x);
        end = turns.y;
        has_root = turns.y > start && cubic_value(c, turns.y) <= 0.0;
    }
    if !has_root {
        start = max(start, turns.y);
        end = s_end;
        has_root = s_end > start && cubic_value(c, s_end) <= 0.0;
    }
    if !has_root { return NO_ROOT; }
    return falling_root(c, start, end);
}

// Lower limit of the largest corner, since the cubic is divided by it.
const LEAST_CORNER: f32 = 1.2e-38;

// Returns (s, value at the start): the first s on [0, s_end] along a line through a cell where the field is <= 0, or
// -1; and the field at s = 0 in units of the largest corner. Scaling by the largest corner keeps products of
// coefficients in range. If all corners are positive the cell has no root, and the cubic is not evaluated.
fn root_in_cell(c: array<f32, 8>, p: vec3f, direction: vec3f, s_end: f32) -> vec2f {
    let low = vec4f(c[0], c[1], c[2], c[3]);
    let high = vec4f(c[4], c[5], c[6], c[7]);
    let smallest = min(low, high);
    if min(min(smallest.x, smallest.y), min(smallest.z, smallest.w)) > 0.0 { return vec2f(-1.0, 1.0); }
    let sizes = max(abs(low), abs(high));
    let largest = max(max(max(sizes.x, sizes.y), max(sizes.z, sizes.w)), LEAST_CORNER);
    let cubic = cubic_along_ray(c, p, direction) / largest;
    return vec2f(first_root(cubic, s_end), cubic.x);
}

// The axis of the face through which a line leaves a box. `to_faces` holds the t of the exit face along each axis.
fn first_axis(to_faces: vec3f) -> u32 {
    if to_faces.x <= to_faces.y && to_faces.x <= to_faces.z { return 0u; }
    return select(2u, 1u, to_faces.y <= to_faces.z);
}
