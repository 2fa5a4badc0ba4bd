// Rays and cones of the light pass, and their results.

// 0 in every invocation, but not a constant for a compiler. Mesa's software driver compiles a kernel again for new
// values of the uniforms that alone decide a branch, and keeps every variant. Such a branch depends on the sum with
// this number.
var<private> zero: u32;

fn begin_invocation(id: vec3u) {
    zero = id.x / 0x7fffffffu;
}

struct Beam {
    p: vec3f,
    t_max: f32,
    // Unit vector.
    direction: vec3f,
    // Growth of a cone's radius with distance; 0 for a ray.
    slope: f32,
    normal: vec3f,
    bias_voxels: f32,
    own: u32,
    // 0: the cone of a light's disc, or a ray. 1: a part of a disc, for which only the fraction is used, not whether it
    // is proven.
    is_coarse: u32,
    // Index of the cut of the tree at which the search starts. ROOT: it starts at the root. ROOT_WITHOUT_OWN: the same,
    // and light passes through the own instance: it casts no shadow, and the far field is not used.
    cut: u32,
    // Index of the answer of this beam.
    owner: u32,
}

struct BeamResult {
    // Fraction that passes, or a length inside.
    value: f32,
    // 1 if a cone decides the disc of a light, DIVIDED if the parts of the disc do.
    is_proven: u32,
    steps: u32,
    // 1 if the value is known. 0 if the steps ran out, NEEDS_EDGE if a ray past an edge is needed.
    is_complete: u32,
    // Number of rays and cones that entered the far field.
    is_far: u32,
}

const NEEDS_EDGE: u32 = 2u;
const DIVIDED: u32 = 2u;
// 2 pi (1 - 1 / golden ratio).
const GOLDEN_ANGLE: f32 = 2.3999632;

// Two unit vectors perpendicular to a unit vector and to each other, as `basis` in src/scene/light/light_rays.rs.
struct Axes {
    right: vec3f,
    up: vec3f,
}

fn axes_of(d: vec3f) -> Axes {
    let side = select(-1.0, 1.0, d.z >= 0.0);
    let a = -1.0 / (side + d.z);
    let b = d.x * d.y * a;
    return Axes(vec3f(1.0 + side * d.x * d.x * a, side * b, -side * d.x), vec3f(b, side + d.y * d.y * a, -d.y));
}
