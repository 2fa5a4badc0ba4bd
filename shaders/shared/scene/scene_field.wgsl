// The instances of a scene, the records of their fields, and rays transformed between their spaces. Twin of
// src/scene/fields/device_fields.rs.

struct SceneInstance {
    // Rows of the affine map from scene space to field space.
    field_x: vec4f,
    field_y: vec4f,
    field_z: vec4f,
    // Rows of the map of directions from scene space to the object's own axes.
    local_x: vec3f,
    opacity: f32,
    local_y: vec3f,
    least_stretch: f32,
    local_z: vec3f,
    largest_stretch: f32,
    // Rows of the map of normals from scene space to field space.
    normal_x: vec3f,
    field: u32,
    normal_y: vec3f,
    casts_shadow: u32,
    normal_z: vec3f,
    // Voxel size of a level of a far field, scene units; 0 for an instance.
    voxel: f32,
    box_min: vec3f,
    // 1 if cones are estimated by thin rays for this instance.
    prefers_rays: u32,
    box_max: vec3f,
    pad_1: u32,
    surface_lower: vec3f,
    // Radius of the ball around the surface, centred in the box of the surface. Field space.
    surface_radius: f32,
    surface_upper: vec3f,
    pad_2: u32,
    field_extent: vec3f,
    pad_3: u32,
}

// A field of any kind. Only sampled kinds have a shape and a spacing.
struct SceneField {
    shape: vec3u,
    // Index of the field's first value in `samples`.
    first_sample: u32,
    spacing: vec3f,
    // Index of the field's first byte in `blocks`.
    first_block: u32,
    blocks: vec3u,
    kind: u32,
}

const KIND_DENSE: u32 = 0u;
const KIND_SPARSE: u32 = 1u;
const KIND_QUADRIC: u32 = 2u;
const KIND_SHAPE: u32 = 3u;
const KIND_NESTED: u32 = 4u;

@group(0) @binding(3) var<storage, read> instances: array<SceneInstance>;
@group(0) @binding(4) var<storage, read> fields: array<SceneField>;
// Samples and parameters of all fields. The layout depends on the kind of the field.
@group(0) @binding(5) var<storage, read> samples: array<f32>;
// Distance of each block of cells to the nearest block with a surface, in blocks; four bytes to a word.
@group(0) @binding(6) var<storage, read> blocks: array<u32>;

const FAR_T: f32 = 1e30;
const PARALLEL: f32 = 1e-20;
const TINY: f32 = 1.2e-38;
// Largest number of steps of an invocation, over all its loops. Software drivers stop it at 65,535 without an error.
const MAX_STEPS: u32 = 50000u;

var<private> steps: u32;

// Clips the ray interval `part` to a box. Returns (t_enter, t_exit); a miss returns t_enter > t_exit.
fn clip(origin: vec3f, direction: vec3f, lower: vec3f, upper: vec3f, part: vec2f) -> vec2f {
    var span = part;
    for (var axis = 0u; axis < 3u; axis++) {
        let low = lower[axis] - origin[axis];
        let high = upper[axis] - origin[axis];
        if abs(direction[axis]) < PARALLEL {
            if low > 0.0 || high < 0.0 { return vec2f(1.0, 0.0); }
            continue;
        }
        let a = low / direction[axis];
        let b = high / direction[axis];
        span = vec2f(max(span.x, min(a, b)), min(span.y, max(a, b)));
    }
    return span;
}

struct FieldRay {
    origin: vec3f,
    direction: vec3f,
}

fn field_direction(index: u32, d: vec3f) -> vec3f {
    let to = &instances[index];
    return vec3f(dot((*to).field_x.xyz, d), dot((*to).field_y.xyz, d), dot((*to).field_z.xyz, d));
}

fn local_direction(index: u32, d: vec3f) -> vec3f {
    let to = &instances[index];
    return vec3f(dot((*to).local_x, d), dot((*to).local_y, d), dot((*to).local_z, d));
}

// The scene normal, not of unit length, of a normal in the object's own axes.
fn scene_normal(index: u32, n: vec3f) -> vec3f {
    let to = &instances[index];
    return (*to).local_x * n.x + (*to).local_y * n.y + (*to).local_z * n.z;
}
