// Draws a field. One invocation computes one pixel: its ray and its shadow rays. Twin of src/render/mod.rs and
// src/render/shade.rs. The importing kernel must define `field_at`, `first_hit` of a ray, and `slope_at` a point.

#import clip
#import light
#import picture_rays

struct MarchParams {
    // Rays in grid space. Depth is in units of the smallest side of a voxel.
    rays: PictureRays,
    // Number of voxels of the field along each axis. Nested fields count as if every level were as fine as the finest.
    shape: vec3u,
    // First row that `pixels` holds, and one past the last row.
    band_start: u32,
    color: vec3f,
    band_end: u32,
    // Voxel size divided by its smallest side.
    relative_spacing: vec3f,
    ambient: f32,
    background: vec4f,
    specular: f32,
    shininess: f32,
    // Distance of the start of a shadow ray from the surface, voxels.
    bias_voxels: f32,
    pad_0: u32,
}

struct Pixel {
    color: vec4f,
    normal: vec3f,
    // Depth beyond the start of the ray, in units of the smallest side of a voxel.
    depth: f32,
    steps: u32,
    is_hit: u32,
    pad_0: u32,
    pad_1: u32,
}

@group(0) @binding(0) var<storage, read> params: MarchParams;
@group(0) @binding(2) var<storage, read> lights: array<Light>;
@group(0) @binding(3) var<storage, read_write> pixels: array<Pixel>;
// Fraction of each light that arrives, `light_count` values per pixel.
@group(0) @binding(4) var<storage, read_write> shares: array<f32>;

// The gradient at a point in grid space of `shape` voxels, averaged over one voxel around the point.
fn slope_over_voxel(p_grid: vec3f, shape: vec3u) -> vec3f {
    var per_voxel: vec3f;
    for (var axis = 0u; axis < 3u; axis++) {
        var half_voxel = vec3f(0.0);
        half_voxel[axis] = 0.5;
        per_voxel[axis] = field_at(p_grid + half_voxel, shape) - field_at(p_grid - half_voxel, shape);
    }
    return per_voxel;
}

// World normal at a point of the surface. Returns `fallback` where the gradient is zero.
fn surface_normal(p_grid: vec3f, fallback: vec3f) -> vec3f {
    let per_voxel = slope_at(p_grid);
    let sizes = abs(per_voxel);
    let largest = max(sizes.x, max(sizes.y, sizes.z));
    if largest < TINY { return fallback; }
    return normalize(per_voxel / largest / params.relative_spacing);
}

// 0 if the field occludes the light, else 1.
fn share_that_arrives(p_grid: vec3f, normal: vec3f, to_light: vec3f) -> f32 {
    if dot(normal, to_light) <= 0.0 { return 0.0; }
    // The bias is the extent of a voxel along the normal.
    let voxel = length(normal * params.relative_spacing);
    let origin = p_grid + params.bias_voxels * voxel * normal / params.relative_spacing;
    let ray = clip_to_box(origin, to_light / params.relative_spacing, params.shape);
    if !ray.is_in_box { return 1.0; }
    return select(1.0, 0.0, first_hit(ray).is_hit);
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let x = id.x;
    let y = id.y + params.rays.first_row;
    if x >= params.rays.width || y >= params.band_end { return; }
    let index = x + params.rays.width * (y - params.band_start);
    var pixel: Pixel;
    pixel.color = params.background;
    for (var i = 0u; i < min(params.rays.light_count, MAX_LIGHTS); i++) { shares[index * params.rays.light_count + i] = 1.0; }

    let line = picture_ray(params.rays, x, y);
    let ray = clip_to_box(line.start, line.along, params.shape);
    if ray.is_in_box {
        let hit = first_hit(ray);
        pixel.steps = hit.steps;
        if hit.is_hit {
            let p_grid = ray.origin + hit.t * ray.direction;
            let to_eye = -normalize(line.along * params.relative_spacing);
            var normal: vec3f;
            if !hit.at_start {
                normal = surface_normal(p_grid, to_eye);
            } else if ray.enter_axis != NO_AXIS {
                // The hit lies on a face of the box, which cuts the solid: the normal of the face is used.
                normal[ray.enter_axis] = select(-1.0, 1.0, to_eye[ray.enter_axis] >= 0.0);
            } else {
                // The eye is inside the solid.
                normal = to_eye;
            }

            var color = params.ambient * params.color;
            for (var i = 0u; i < min(params.rays.light_count, MAX_LIGHTS); i++) {
                var share = 1.0;
                if params.rays.shadows == 1u { share = share_that_arrives(p_grid, normal, -lights[i].direction); }
                shares[index * params.rays.light_count + i] = share;
                color += share * light_adds(lights[i], params.color, normal, to_eye, params.specular, params.shininess);
            }
            pixel.color = vec4f(color, 1.0);
            pixel.normal = normal;
            pixel.depth = ray.t_enter + hit.t / length(line.along);
            pixel.is_hit = 1u;
        }
    }
    pixels[index] = pixel;
}
