// Distances and gradients of sampled fields, inside and outside their grids. Twin of `SampledField` in
// src/scene/field.rs.

#import scene_samples

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
    let b = into_data(field, p);
    return distance_beyond(field, p, b, sample_in_data(field, b));
}

fn sampled_gradient(field: SceneField, point: vec3f) -> vec3f {
    let last = vec3f(field.shape) - 0.5;
    let low = min(vec3f(0.5), last - 1.0);
    let p = min(max(point, low), max(last - 1.0, low));
    var slope: vec3f;
    for (var axis = 0u; axis < 3u; axis++) {
        var half = vec3f(0.0);
        half[axis] = 0.5;
        slope[axis] = sample_field(field, p + half) - sample_field(field, p - half);
    }
    slope /= field.spacing;
    let largest = max(abs(slope.x), max(abs(slope.y), abs(slope.z)));
    if largest == 0.0 { return vec3f(0.0); }
    return normalize(slope / largest);
}

// Unit direction of the gradient in the cell at a point of the box with the distance s; zero where there is none. The
// field is linear along an axis in its cell, so the farther face of the cell gives the slope.
fn direction_at_rim(field: SceneField, point: vec3f, s: f32) -> vec3f {
    let last = vec3f(field.shape) - 1.0;
    let b = clamp(point, vec3f(0.0), last);
    let first = floor(min(b, max(last - 1.0, vec3f(0.0))));
    let face = select(first, first + 1.0, b - first < vec3f(0.5));
    var slope: vec3f;
    for (var axis = 0u; axis < 3u; axis++) {
        var p = b;
        p[axis] = face[axis];
        slope[axis] = (sample_field(field, p) - s) / (face[axis] - b[axis]);
    }
    slope /= field.spacing;
    let largest = max(abs(slope.x), max(abs(slope.y), abs(slope.z)));
    if largest == 0.0 { return vec3f(0.0); }
    return normalize(slope / largest);
}

// An estimate of the distance, closer than the lower bound outside the grid.
fn sampled_guess(field: SceneField, p: vec3f) -> f32 {
    let b = into_data(field, p);
    let s = sample_in_data(field, b);
    if all(p == b) { return s; }
    return length((p - b) * field.spacing + max(s, 0.0) * direction_at_rim(field, b, s));
}
