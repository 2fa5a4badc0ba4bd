// Distances and gradients of sampled fields, inside and outside their grids. Twin of `SampledField` in
// src/scene/fields/field.rs.

#import scene_levels

// The point of the grid's box that is nearest to `p`. Grid space.
fn into_data(field: SceneField, p: vec3f) -> vec3f {
    return clamp(p, vec3f(-0.5), vec3f(field.shape) - 0.5);
}

fn sample_field(field: SceneField, p: vec3f) -> f32 {
    return sample_in_data(field, into_data(field, p));
}

// A lower bound on the distance at p, if the distance at the nearest point b of the box is s.
fn distance_beyond(field: SceneField, p: vec3f, b: vec3f, s: f32) -> f32 {
    let outside = (p - b) * field.spacing;
    let a_squared = dot(outside, outside);
    if a_squared == 0.0 { return s; }
    return sqrt(a_squared + max(s, 0.0) * max(s, 0.0));
}

// Distance in the object's units. Outside the grid it is a lower bound.
fn sampled_distance(field: SceneField, p: vec3f) -> f32 {
    let at = at_level(field, p);
    let b = into_data(at.field, at.p);
    return distance_beyond(at.field, at.p, b, sample_in_data(at.field, b));
}

fn sampled_gradient(field: SceneField, p: vec3f) -> vec3f {
    let at = at_level(field, p);
    let last = vec3f(at.field.shape) - 0.5;
    let low = min(vec3f(0.5), last - 1.0);
    let slope = slope_in_data(at.field, min(max(at.p, low), max(last - 1.0, low))) / at.field.spacing;
    let largest = max(abs(slope.x), max(abs(slope.y), abs(slope.z)));
    if largest == 0.0 { return vec3f(0.0); }
    return normalize(slope / largest);
}

// An estimate of the distance, closer than the lower bound `distance` outside the grid.
fn sampled_guess(whole: SceneField, point: vec3f, distance: f32) -> f32 {
    let at = at_level(whole, point);
    let field = at.field;
    let p = at.p;
    let b = into_data(field, p);
    let is_inside = all(p == b);
    // The field is linear along an axis in its cell, so the farther face of the cell gives the slope.
    let last = vec3f(field.shape) - 1.0;
    let rim = clamp(b, vec3f(0.0), last);
    let first = floor(min(rim, max(last - 1.0, vec3f(0.0))));
    let face = select(first, first + 1.0, rim - first < vec3f(0.5));
    var s = distance;
    var slope: vec3f;
    // Inside the grid the loop has no rounds. Software drivers would execute all of a branch in its place.
    for (var i = 0u; i < select(4u, 0u, is_inside); i++) {
        var q = select(rim, b, i == 0u);
        let axis = max(i, 1u) - 1u;
        if i > 0u { q[axis] = face[axis]; }
        let value = sample_in_data(field, q);
        if i == 0u { s = value; } else { slope[axis] = (value - s) / (face[axis] - rim[axis]); }
    }
    if is_inside { return s; }
    slope /= field.spacing;
    let largest = max(abs(slope.x), max(abs(slope.y), abs(slope.z)));
    // Unit direction of the gradient; zero where there is none.
    var direction = vec3f(0.0);
    if largest != 0.0 { direction = normalize(slope / largest); }
    return length((p - b) * field.spacing + max(s, 0.0) * direction);
}
