// Draws the voxels of a float32 field whose samples are <= 0: the field of the nearest samples. Twin of
// src/march/voxels.rs.

#import samples
#import cubic
#import picture

// Outward normal, in grid space, of the face through which the last hit was entered.
var<private> entered: vec3f;

fn sample_of(voxel: vec3i, shape: vec3u) -> f32 {
    let place = vec3u(voxel);
    return stored_sample(place.x + shape.x * (place.y + shape.y * place.z));
}

// The sample of the voxel that contains a point of grid space.
fn field_at(p_grid: vec3f, shape: vec3u) -> f32 {
    return sample_of(clamp(vec3i(floor(p_grid + 0.5)), vec3i(0), vec3i(shape) - 1), shape);
}

// Traces a ray to the first voxel of the solid.
fn first_hit(ray: ClippedRay) -> Hit {
    var hit: Hit;
    let last = vec3i(params.shape) - 1;
    let forward = ray.direction > vec3f(0.0);
    let side = select(vec3f(-0.5), vec3f(0.5), forward);
    let is_parallel = abs(ray.direction) < vec3f(PARALLEL);
    let inverse = 1.0 / select(ray.direction, vec3f(1.0), is_parallel);

    var t = 0.0;
    var voxel = clamp(vec3i(floor(ray.origin + 0.5)), vec3i(0), last);
    entered = vec3f(0.0);
    // The index of a voxel never moves back along the ray.
    let max_steps = params.shape.x + params.shape.y + params.shape.z;
    for (var step = 1u; step <= max_steps; step++) {
        hit.steps = step;
        if sample_of(voxel, params.shape) <= 0.0 {
            hit.is_hit = true;
            hit.t = t;
            hit.at_start = step == 1u;
            return hit;
        }
        let to_faces = select((vec3f(voxel) + side - ray.origin) * inverse, vec3f(FAR_T), is_parallel);
        let axis = first_axis(to_faces);
        t = max(to_faces[axis], t);
        let way = select(-1, 1, forward[axis]);
        voxel[axis] += way;
        if t >= ray.t_max || voxel[axis] < 0 || voxel[axis] > last[axis] { return hit; }
        entered = vec3f(0.0);
        entered[axis] = -f32(way);
    }
    return hit;
}

fn slope_at(p_grid: vec3f) -> vec3f {
    return entered;
}
