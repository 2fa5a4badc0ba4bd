// Intersections of rays with a quadric, in the frame of its trim sphere. Twin of src/quadric/local.rs.

// The quadratic form q^T m q + 2 v.q + w.
struct QuadricForm {
    m: mat3x3f,
    v: vec3f,
    w: f32,
}

// Larger than the t of any crossing.
const NO_CROSSING: f32 = 3.0e38;
// Relative error of a coefficient of the quadratic: 16 machine epsilons.
const QUADRIC_EPS: f32 = 1.9073486e-6;

// Both crossings of a ray with the quadric inside the unit ball, as distances from the origin in radii, in no
// particular order. A missing crossing is NO_CROSSING. The direction must have unit length.
fn quadric_crossings(form: QuadricForm, origin: vec3f, direction: vec3f) -> vec2f {
    // The nearest point to the centre is computed in two rounds: from a thousand radii away, the first subtraction
    // alone is rounded by too much.
    let about = dot(origin, direction);
    let almost = origin - about * direction;
    let rest = dot(almost, direction);
    let start = about + rest;
    let nearest = almost - rest * direction;
    let half_chord_squared = 1.0 - dot(nearest, nearest);
    if half_chord_squared < 0.0 { return vec2f(NO_CROSSING); }
    let half_chord = sqrt(half_chord_squared);

    let slope = form.m * nearest + form.v;
    let a = dot(direction, form.m * direction);
    let b = dot(direction, slope);
    let c = dot(nearest, form.m * nearest) + 2.0 * dot(form.v, nearest) + form.w;
    let discriminant = b * b - a * c;
    let unsure = 2.0 * QUADRIC_EPS * (abs(a) + abs(b) + abs(c)) + QUADRIC_EPS * QUADRIC_EPS;
    if discriminant < -unsure { return vec2f(NO_CROSSING); }
    let root = sqrt(max(discriminant, 0.0));
    let k = select(root - b, -(b + root), b >= 0.0);

    var crossings = vec2f(NO_CROSSING);
    if a != 0.0 && abs(k) <= half_chord * abs(a) { crossings.x = k / a - start; }
    if k != 0.0 && abs(c) <= half_chord * abs(k) { crossings.y = c / k - start; }
    return crossings;
}
