// Ray tracing and normals for a picture of a single grid, whose space is the space of the picture.

fn first_hit(ray: ClippedRay) -> Hit {
    return march(ray, params.shape);
}

fn slope_at(p_grid: vec3f) -> vec3f {
    return slope_over_voxel(p_grid, params.shape);
}
