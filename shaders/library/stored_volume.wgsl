// The stored distance of a voxel, world units. A voxel outside the grid reads the nearest voxel inside.
fn field_voxel(voxel: vec3i) -> f32 {
    return f32(textureLoad(field_texels, clamp(voxel, vec3i(0), FIELD_SHAPE - 1), 0).x) * FIELD_SCALE;
}

// Bilinear interpolation within one slice.
fn field_slice(cell: vec3i, fraction: vec2f) -> f32 {
    let low = mix(field_voxel(cell), field_voxel(cell + vec3i(1, 0, 0)), fraction.x);
    let high = mix(field_voxel(cell + vec3i(0, 1, 0)), field_voxel(cell + vec3i(1, 1, 0)), fraction.x);
    return mix(low, high, fraction.y);
}

// A sample that bounds the distance outside the box.
fn field_bound_sample(voxel: vec3i) -> f32 {
    return field_voxel(voxel);
}

// The distance at p in world space: trilinear inside the box, a lower bound outside.
fn field_distance(p: vec3f) -> f32 {
    let p_grid = (p - FIELD_LOWER) / FIELD_SPACING - 0.5;
    if any(p_grid < vec3f(-0.5)) || any(p_grid > vec3f(FIELD_SHAPE) - 0.5) {
        return field_bound(p);
    }
    let cell = floor(p_grid);
    let fraction = p_grid - cell;
    let near = field_slice(vec3i(cell), fraction.xy);
    let far = field_slice(vec3i(cell) + vec3i(0, 0, 1), fraction.xy);
    return mix(near, far, fraction.z);
}

// The gradient at p by differences over one voxel; at the surface it points outwards.
fn field_gradient(p: vec3f) -> vec3f {
    let h = 0.5 * FIELD_SPACING;
    let x = field_distance(p + vec3f(h.x, 0.0, 0.0)) - field_distance(p - vec3f(h.x, 0.0, 0.0));
    let y = field_distance(p + vec3f(0.0, h.y, 0.0)) - field_distance(p - vec3f(0.0, h.y, 0.0));
    let z = field_distance(p + vec3f(0.0, 0.0, h.z)) - field_distance(p - vec3f(0.0, 0.0, h.z));
    return vec3f(x, y, z) / FIELD_SPACING;
}
