"""Sources of the shader functions that evaluate stored fields.

Each kind has two texts: WGSL, and a C dialect from which :mod:`.shader` makes GLSL, HLSL and MSL by renaming types. The
dialect is GLSL without vectors made of one scalar, matrices, arrays and operators on booleans. ``texelFetch`` has
variables as arguments. The constants of a field are written in front of either text.
"""

from __future__ import annotations

VOLUME_WGSL = """
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
"""

VOLUME_C = """
// The stored distance of a voxel, world units. A voxel outside the grid reads the nearest voxel inside.
float field_voxel(ivec3 voxel) {
    ivec3 at = clamp(voxel, ivec3(0, 0, 0), FIELD_SHAPE - ivec3(1, 1, 1));
    return texelFetch(field_texels, at, 0).x * FIELD_SCALE;
}

// Bilinear interpolation within one slice.
float field_slice(ivec3 cell, vec2 fraction) {
    float low = mix(field_voxel(cell), field_voxel(cell + ivec3(1, 0, 0)), fraction.x);
    float high = mix(field_voxel(cell + ivec3(0, 1, 0)), field_voxel(cell + ivec3(1, 1, 0)), fraction.x);
    return mix(low, high, fraction.y);
}

// The distance at p in world space: trilinear inside the box. Outside, with the distance a to the box and the value s
// at its nearest point, it is sqrt(a^2 + s^2), a lower bound for surfaces that lie in the box.
float field_distance(vec3 p) {
    vec3 half_voxel = vec3(0.5, 0.5, 0.5);
    vec3 p_grid = (p - FIELD_LOWER) / FIELD_SPACING - half_voxel;
    vec3 clamped = clamp(p_grid, -half_voxel, vec3(FIELD_SHAPE) - half_voxel);
    vec3 cell = floor(clamped);
    vec3 fraction = clamped - cell;
    float near_value = field_slice(ivec3(cell), fraction.xy);
    float far_value = field_slice(ivec3(cell) + ivec3(0, 0, 1), fraction.xy);
    float value = mix(near_value, far_value, fraction.z);
    vec3 outside = (p_grid - clamped) * FIELD_SPACING;
    float squared = dot(outside, outside);
    return squared > 0.0 ? sqrt(squared + max(value, 0.0) * max(value, 0.0)) : value;
}

// The gradient at p by differences over one voxel; at the surface it points outwards.
vec3 field_gradient(vec3 p) {
    vec3 h = 0.5 * FIELD_SPACING;
    float x = field_distance(p + vec3(h.x, 0.0, 0.0)) - field_distance(p - vec3(h.x, 0.0, 0.0));
    float y = field_distance(p + vec3(0.0, h.y, 0.0)) - field_distance(p - vec3(0.0, h.y, 0.0));
    float z = field_distance(p + vec3(0.0, 0.0, h.z)) - field_distance(p - vec3(0.0, 0.0, h.z));
    return vec3(x, y, z) / FIELD_SPACING;
}
"""

NESTED_WGSL = """
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

// The distance at p in world space, from the finest level whose voxel centres surround p. Outside the outermost box,
// with the distance a to it and the value s at its nearest point, it is sqrt(a^2 + s^2).
fn nested_distance(p: vec3f) -> f32 {
    var level = 0;
    while level < NESTED_LEVELS - 1 && !nested_holds(level, p) {
        level = level + 1;
    }
    let p_grid = (p - nested_lower(level)) / nested_spacing(level) - 0.5;
    let clamped = clamp(p_grid, vec3f(-0.5), vec3f(NESTED_SHAPE) - 0.5);
    let cell = floor(clamped);
    let fraction = clamped - cell;
    let near = nested_slice(level, vec3i(cell), fraction.xy);
    let far = nested_slice(level, vec3i(cell) + vec3i(0, 0, 1), fraction.xy);
    let value = mix(near, far, fraction.z);
    let outside = (p_grid - clamped) * nested_spacing(level);
    let squared = dot(outside, outside);
    return select(value, sqrt(squared + max(value, 0.0) * max(value, 0.0)), squared > 0.0);
}
"""

NESTED_C = """
// The stored distance of a voxel of a level. A voxel outside the grid reads the nearest voxel inside.
float nested_voxel(int level, ivec3 voxel) {
    ivec3 at = clamp(voxel, ivec3(0, 0, 0), NESTED_SHAPE - ivec3(1, 1, 1)) + ivec3(0, 0, level * NESTED_SHAPE.z);
    return texelFetch(nested_texels, at, 0).x;
}

// Bilinear interpolation within one slice of a level.
float nested_slice(int level, ivec3 cell, vec2 fraction) {
    ivec3 above = cell + ivec3(0, 1, 0);
    float low = mix(nested_voxel(level, cell), nested_voxel(level, cell + ivec3(1, 0, 0)), fraction.x);
    float high = mix(nested_voxel(level, above), nested_voxel(level, above + ivec3(1, 0, 0)), fraction.x);
    return mix(low, high, fraction.y);
}

// Whether the voxel centres of a level surround p.
bool nested_holds(int level, vec3 p) {
    vec3 p_grid = (p - nested_lower(level)) / nested_spacing(level) - vec3(0.5, 0.5, 0.5);
    vec3 last = vec3(NESTED_SHAPE) - vec3(1.0, 1.0, 1.0);
    bool above = p_grid.x >= 0.0 && p_grid.y >= 0.0 && p_grid.z >= 0.0;
    return above && p_grid.x <= last.x && p_grid.y <= last.y && p_grid.z <= last.z;
}

// The distance at p in world space, from the finest level whose voxel centres surround p. Outside the outermost box,
// with the distance a to it and the value s at its nearest point, it is sqrt(a^2 + s^2).
float nested_distance(vec3 p) {
    int level = 0;
    while (level < NESTED_LEVELS - 1 && !nested_holds(level, p)) {
        level = level + 1;
    }
    vec3 half_voxel = vec3(0.5, 0.5, 0.5);
    vec3 p_grid = (p - nested_lower(level)) / nested_spacing(level) - half_voxel;
    vec3 clamped = clamp(p_grid, -half_voxel, vec3(NESTED_SHAPE) - half_voxel);
    vec3 cell = floor(clamped);
    vec3 fraction = clamped - cell;
    float near_value = nested_slice(level, ivec3(cell), fraction.xy);
    float far_value = nested_slice(level, ivec3(cell) + ivec3(0, 0, 1), fraction.xy);
    float value = mix(near_value, far_value, fraction.z);
    vec3 outside = (p_grid - clamped) * nested_spacing(level);
    float squared = dot(outside, outside);
    return squared > 0.0 ? sqrt(squared + max(value, 0.0) * max(value, 0.0)) : value;
}
"""

SPARSE_WGSL = """
// One word per brick. Bits 31-30: level 0 to 2, whose cells have 2^level voxels; bits 29-0: index of the stored brick.
// Level 3 marks an empty brick; bit 0 then tells inside (1) from outside (0).
@group(0) @binding(0) var sparse_index: texture_3d<u32>;
// Lower bounds of the distance at the corners of the bricks, in units of SPARSE_LONGEST_STEP.
@group(0) @binding(1) var sparse_nodes: texture_3d<f32>;
// The samples: 512 texels per brick, x fastest, in rows of SPARSE_ROW texels.
@group(0) @binding(2) var sparse_bricks: texture_2d<f32>;

// A stored sample, world units.
fn sparse_sample(at: i32) -> f32 {
    return textureLoad(sparse_bricks, vec2i(at % SPARSE_ROW, at / SPARSE_ROW), 0).x * SPARSE_SCALE;
}

// Bilinear interpolation of the samples of a brick from number `first` on.
fn sparse_slice(first: i32, fraction: vec2f) -> f32 {
    let low = mix(sparse_sample(first), sparse_sample(first + 1), fraction.x);
    let high = mix(sparse_sample(first + 8), sparse_sample(first + 9), fraction.x);
    return mix(low, high, fraction.y);
}

// Lower bound at a voxel's corner in an empty brick: the mean of the squares around it less the variance of the
// weights.
fn sparse_bound(brick: vec3i, corner: vec3i) -> f32 {
    // Node 0 lies at voxel -1, and nodes are 7 voxels apart.
    let f = clamp(vec3f(corner + 1) / 7.0 - vec3f(brick), vec3f(0.0), vec3f(1.0));
    var mean = 0.0;
    for (var i = 0; i < 8; i++) {
        let side = vec3i(i & 1, (i / 2) & 1, i / 4);
        let node = textureLoad(sparse_nodes, brick + side, 0).x;
        let weights = mix(1.0 - f, f, vec3f(side));
        mean += weights.x * weights.y * weights.z * node * node;
    }
    let variance = dot(SPARSE_NODE_STEP * SPARSE_NODE_STEP, f * (1.0 - f));
    return max(sqrt(max(mean - variance, 0.0)) * SPARSE_LONGEST_STEP, SPARSE_FLOOR);
}

// The distance at p in world space: trilinear in the stored bricks, a lower bound with its sign in the empty ones.
// Outside the box, with the distance a to it and the value s at its nearest point, it is sqrt(a^2 + s^2).
fn sparse_distance(p: vec3f) -> f32 {
    let p_grid = (p - SPARSE_LOWER) / SPARSE_SPACING - 0.5;
    let clamped = clamp(p_grid, vec3f(-0.5), vec3f(SPARSE_SHAPE) - 0.5);
    let cell = vec3i(floor(clamped));
    let brick = min((cell + 1) / 7, SPARSE_COUNTS - 1);
    let word = textureLoad(sparse_index, brick, 0).x;
    let level = word >> 30u;
    var value = 0.0;
    if level < 3u {
        let cells = i32(1u << level);
        let origin = 7 * (brick / cells * cells) - 1;
        let local = (cell - origin) / cells;
        let fraction = (clamped - vec3f(origin + local * cells)) / f32(cells);
        let first = i32(word & 0x3fffffffu) * 512 + local.x + 8 * (local.y + 8 * local.z);
        value = mix(sparse_slice(first, fraction.xy), sparse_slice(first + 64, fraction.xy), fraction.z);
    } else {
        let fraction = clamped - vec3f(cell);
        for (var i = 0; i < 8; i++) {
            let side = vec3i(i & 1, (i / 2) & 1, i / 4);
            let weights = mix(1.0 - fraction, fraction, vec3f(side));
            value += weights.x * weights.y * weights.z * sparse_bound(brick, cell + side);
        }
        value = select(value, -value, (word & 1u) == 1u);
    }
    let outside = (p_grid - clamped) * SPARSE_SPACING;
    let squared = dot(outside, outside);
    return select(value, sqrt(squared + max(value, 0.0) * max(value, 0.0)), squared > 0.0);
}
"""

SPARSE_C = """
// A stored sample, world units.
float sparse_sample(int number) {
    ivec2 at = ivec2(number % SPARSE_ROW, number / SPARSE_ROW);
    return texelFetch(sparse_bricks, at, 0).x * SPARSE_SCALE;
}

// Bilinear interpolation of the samples of a brick from number `first` on.
float sparse_slice(int first, vec2 fraction) {
    float low = mix(sparse_sample(first), sparse_sample(first + 1), fraction.x);
    float high = mix(sparse_sample(first + 8), sparse_sample(first + 9), fraction.x);
    return mix(low, high, fraction.y);
}

// Lower bound at a voxel's corner in an empty brick: the mean of the squares around it less the variance of the
// weights.
float sparse_bound(ivec3 brick, ivec3 corner) {
    vec3 one = vec3(1.0, 1.0, 1.0);
    // Node 0 lies at voxel -1, and nodes are 7 voxels apart.
    vec3 f = clamp(vec3(corner + ivec3(1, 1, 1)) / 7.0 - vec3(brick), vec3(0.0, 0.0, 0.0), one);
    float mean = 0.0;
    for (int i = 0; i < 8; i++) {
        ivec3 side = ivec3(i & 1, (i / 2) & 1, i / 4);
        ivec3 at = brick + side;
        float node = texelFetch(sparse_nodes, at, 0).x;
        vec3 weights = mix(one - f, f, vec3(side));
        mean += weights.x * weights.y * weights.z * node * node;
    }
    float variance = dot(SPARSE_NODE_STEP * SPARSE_NODE_STEP, f * (one - f));
    return max(sqrt(max(mean - variance, 0.0)) * SPARSE_LONGEST_STEP, SPARSE_FLOOR);
}

// The distance at p in world space: trilinear in the stored bricks, a lower bound with its sign in the empty ones.
// Outside the box, with the distance a to it and the value s at its nearest point, it is sqrt(a^2 + s^2).
float sparse_distance(vec3 p) {
    vec3 one = vec3(1.0, 1.0, 1.0);
    vec3 p_grid = (p - SPARSE_LOWER) / SPARSE_SPACING - 0.5 * one;
    vec3 clamped = clamp(p_grid, -0.5 * one, vec3(SPARSE_SHAPE) - 0.5 * one);
    ivec3 cell = ivec3(floor(clamped));
    ivec3 brick = min((cell + ivec3(1, 1, 1)) / 7, SPARSE_COUNTS - ivec3(1, 1, 1));
    uint word = texelFetch(sparse_index, brick, 0).x;
    uint level = word >> 30u;
    float value = 0.0;
    if (level < 3u) {
        int cells = int(1u << level);
        ivec3 origin = 7 * (brick / cells * cells) - ivec3(1, 1, 1);
        ivec3 local = (cell - origin) / cells;
        vec3 fraction = (clamped - vec3(origin + local * cells)) / float(cells);
        int first = int(word & 0x3fffffffu) * 512 + local.x + 8 * (local.y + 8 * local.z);
        value = mix(sparse_slice(first, fraction.xy), sparse_slice(first + 64, fraction.xy), fraction.z);
    } else {
        vec3 fraction = clamped - vec3(cell);
        for (int i = 0; i < 8; i++) {
            ivec3 side = ivec3(i & 1, (i / 2) & 1, i / 4);
            vec3 weights = mix(one - fraction, fraction, vec3(side));
            value += weights.x * weights.y * weights.z * sparse_bound(brick, cell + side);
        }
        value = (word & 1u) == 1u ? -value : value;
    }
    vec3 outside = (p_grid - clamped) * SPARSE_SPACING;
    float squared = dot(outside, outside);
    return squared > 0.0 ? sqrt(squared + max(value, 0.0) * max(value, 0.0)) : value;
}
"""
