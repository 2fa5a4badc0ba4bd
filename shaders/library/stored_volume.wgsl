// The samples as a 3D texture, x along its width, as .ktx2 and .dds files hold them. It is read without a filter.
@group(0) @binding(0) var field_texels: texture_3d<f32>;

// The stored distance of a voxel, world units. A voxel outside the grid reads the nearest voxel inside.
fn field_voxel(voxel: vec3i) -> f32 {
    return textureLoad(field_texels, clamp(voxel, vec3i(0), FIELD_SHAPE - 1), 0).x * FIELD_SCALE;
}

// Bilinear interpolation within one slice.
fn field_slice(cell: vec3i, fraction: vec2f) -> f32 {
    let low = mix(field_voxel(cell), field_voxel(cell + vec3i(1, 0, 0)), fraction.x);
    let high = mix(field_voxel(cell + vec3i(0, 1, 0)), field_voxel(cell + vec3i(1, 1, 0)), fraction.x);
    return mix(low, high, fraction.y);
}

// The distance at p in world space: trilinear inside the box. Outside, with the distance a to the box and the value s
// at its nearest point, it is sqrt(a^2 + s^2), a lower bound for surfaces that lie in the box.
fn field_distance(p: vec3f) -> f32 {
    let p_grid = (p - FIELD_LOWER) / FIELD_SPACING - 0.5;
    let clamped = clamp(p_grid, vec3f(-0.5), vec3f(FIELD_SHAPE) - 0.5);
    let cell = floor(clamped);
    let fraction = clamped - cell;
    let near = field_slice(vec3i(cell), fraction.xy);
    let far = field_slice(vec3i(cell) + vec3i(0, 0, 1), fraction.xy);
    let value = mix(near, far, fraction.z);
    let outside = (p_grid - clamped) * FIELD_SPACING;
    let squared = dot(outside, outside);
    return select(value, sqrt(squared + max(value, 0.0) * max(value, 0.0)), squared > 0.0);
}

// The gradient at p by differences over one voxel; at the surface it points outwards.
fn field_gradient(p: vec3f) -> vec3f {
    let h = 0.5 * FIELD_SPACING;
    let x = field_distance(p + vec3f(h.x, 0.0, 0.0)) - field_distance(p - vec3f(h.x, 0.0, 0.0));
    let y = field_distance(p + vec3f(0.0, h.y, 0.0)) - field_distance(p - vec3f(0.0, h.y, 0.0));
    let z = field_distance(p + vec3f(0.0, 0.0, h.z)) - field_distance(p - vec3f(0.0, 0.0, h.z));
    return vec3f(x, y, z) / FIELD_SPACING;
}
