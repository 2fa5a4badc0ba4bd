// Square of a lower bound on the distance at the point nearest to p among the samples of the bound: the mean of the
// squares around it less the variance of the weights.
fn field_bound_squared(p: vec3f) -> f32 {
    let p_grid = clamp((p - FIELD_BOUND_FIRST) / FIELD_BOUND_STEP, vec3f(0.0), vec3f(FIELD_BOUND_LAST));
    let cell = vec3i(floor(p_grid));
    let f = p_grid - floor(p_grid);
    var mean = 0.0;
    for (var i = 0; i < 8; i++) {
        let side = vec3i(i & 1, (i / 2) & 1, i / 4);
        let value = field_bound_sample(min(cell + side, FIELD_BOUND_LAST));
        let weights = mix(1.0 - f, f, vec3f(side));
        mean += weights.x * weights.y * weights.z * value * value;
    }
    return max(mean - dot(FIELD_BOUND_STEP * FIELD_BOUND_STEP, f * (1.0 - f)), 0.0);
}

// Lower bound on the distance at p outside the box, zero or more. If the samples surround the surface, it is
// sqrt(a^2 + s^2) with the distance a to the hull of the samples, or to the box of the surface, and a bound s at the
// nearest point there; the larger one counts.
fn field_bound(p: vec3f) -> f32 {
    let from_hull = p - clamp(p, FIELD_BOUND_FIRST, FIELD_BOUND_FIRST + FIELD_BOUND_STEP * vec3f(FIELD_BOUND_LAST));
    let from_inner = p - clamp(p, FIELD_INNER_LOWER, FIELD_INNER_UPPER);
    let by_hull = field_bound_squared(p - from_hull);
    if FIELD_SURROUNDS_SURFACE {
        let by_inner = dot(from_inner, from_inner) + field_bound_squared(p - from_inner);
        return sqrt(max(dot(from_hull, from_hull) + by_hull, by_inner));
    }
    return max(sqrt(by_hull) - length(from_hull), length(from_inner));
}
