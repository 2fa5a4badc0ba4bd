// The samples of all levels as one 3D texture: level k has the slices from k * NESTED_SHAPE.z on, finest level first.
@group(0) @binding(0) var nested_texels: texture_3d<f32>;

// The stored distance of a voxel of a level. A voxel outside the grid reads the nearest voxel inside.
fn nested_voxel(level: i32, voxel: vec3i) -> f32 {
    let inside = clamp(voxel, vec3i(0), NESTED_SHAPE - 1);
    return textureLoad(nested_texels, inside + vec3i(0, 0, level * NESTED_SHAPE.z), 0).x;
}

// Bilinear interpolation within one slice of a level.
fn nested_slice(level: i32, cell: vec3i, fraction: vec2f) -> f32 {
    let low = mix(nested_voxel(level, cell), nested_voxel(level, cell + vec3i(1, 0, 0)), fraction.x);
    let above = cell + vec3i(0, 1, 0);
    let high = mix(nested_voxel(level, above), nested_voxel(level, above + vec3i(1, 0, 0)), fraction.x);
    return mix(low, high, fraction.y);
}

// Whether the voxel centres of a level surround p.
fn nested_holds(level: i32, p: vec3f) -> bool {
    let p_grid = (p - nested_lower(level)) / nested_spacing(level) - 0.5;
    return all(p_grid >= vec3f(0.0)) && all(p_grid <= vec3f(NESTED_SHAPE) - 1.0);
}

// A sample that bounds the distance outside the outermost box.
fn nested_bound_sample(voxel: vec3i) -> f32 {
    return nested_voxel(NESTED_LEVELS - 1, voxel);
}

// The distance at p in world space: trilinear in the finest level whose voxel centres surround p, a lower bound
// outside the outermost box.
fn nested_distance(p: vec3f) -> f32 {
    var level = 0;
    while level < NESTED_LEVELS - 1 && !nested_holds(level, p) {
        level = level + 1;
    }
    let p_grid = (p - nested_lower(level)) / nested_spacing(level) - 0.5;
    if any(p_grid < vec3f(-0.5)) || any(p_grid > vec3f(NESTED_SHAPE) - 0.5) {
        return nested_bound(p);
    }
    let cell = floor(p_grid);
    let fraction = p_grid - cell;
    let near = nested_slice(level, vec3i(cell), fraction.xy);
    let far = nested_slice(level, vec3i(cell) + vec3i(0, 0, 1), fraction.xy);
    return mix(near, far, fraction.z);
}
