//! Rays and cones from surfaces to lights: their geometry, and counters of their cost.

use crate::geometry::Aabb;
use glam::{DVec3, Vec2, Vec3};
use std::sync::atomic::{AtomicU64, Ordering};

/// A point on a surface for which light is evaluated.
#[derive(Debug, Clone, Copy)]
pub struct SurfacePoint {
    /// Position, scene space.
    pub p: DVec3,
    /// Unit normal on the visible side.
    pub normal: Vec3,
    /// The instance that the surface belongs to.
    pub own: u32,
    /// Distance by which a ray starts off the field of the own instance, voxels.
    pub bias_voxels: f32,
    /// Offset of the start of a ray past the triangles of the own instance, in units of the mesh's tree: to the smooth
    /// surface above a face, or off the surface of the field of a mesh.
    pub lift: Vec3,
    /// Whether the own instance casts no shadow on the point, because light that scatters passes through it. Far fields
    /// contain the own instance, so they are not used then.
    pub skips_own: bool,
}

impl SurfacePoint {
    /// Whether a ray begins on the visible side of the surface. Light through the own instance may come from behind.
    pub(crate) fn is_above_horizon(&self, ray: &LightRay) -> bool {
        self.skips_own || self.normal.dot(ray.direction.as_vec3()) > 0.0
    }
}

/// The hemisphere above a surface point, in which occluders count.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hemisphere {
    pub place: SurfacePoint,
    /// Largest distance of an occluder, scene units.
    pub distance: f64,
    /// Number of the pattern of directions in which rays are traced.
    pub pattern: usize,
}

/// A ray from a surface point: a unit direction and a length.
#[derive(Debug, Clone, Copy)]
pub struct LightRay {
    pub direction: DVec3,
    pub t_max: f64,
}

/// A cone around a ray from a surface: at the distance `t` its radius is `slope t`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LightCone<'a> {
    pub place: &'a SurfacePoint,
    pub ray: &'a LightRay,
    pub slope: f32,
}

pub(crate) use crate::gpu::constants::scene_counts::PARTS;

/// Two unit vectors at right angles to a unit vector and to each other (Duff et al., *Building an orthonormal basis,
/// revisited*, JCGT 6(1), 2017).
pub(crate) fn basis(n: DVec3) -> [DVec3; 2] {
    let sign = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    [DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), DVec3::new(b, sign + n.y * n.y * a, -n.y)]
}

/// The golden angle, as in kernels.
pub(crate) const GOLDEN_ANGLE: f32 = crate::geometry::GOLDEN_ANGLE as f32;

/// Point `i` of `count` points spread evenly over the unit disc (Vogel 1979), rotated by `turn`.
pub(crate) fn disc_point(i: u32, count: u32, turn: f32) -> Vec2 {
    let radius = ((i as f32 + 0.5) / count as f32).sqrt();
    let angle = i as f32 * GOLDEN_ANGLE + turn;
    radius * Vec2::new(angle.cos(), angle.sin())
}

/// Counters of rays and cones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LightWork {
    pub steps: u32,
    /// Number of rays and cones.
    pub rays: u32,
    /// Number of those that entered the far field.
    pub far_rays: u32,
}

impl LightWork {
    pub fn count(&mut self, is_far: bool) {
        self.rays += 1;
        self.far_rays += u32::from(is_far);
    }
}

impl std::ops::AddAssign for LightWork {
    fn add_assign(&mut self, other: Self) {
        self.steps += other.steps;
        self.rays += other.rays;
        self.far_rays += other.far_rays;
    }
}

/// Largest radius of a cone where it can touch a box, scene units.
pub(crate) fn widest(place: &SurfacePoint, ray: &LightRay, slope: f32, bounds: &Aabb) -> f32 {
    let p = place.p.as_vec3();
    let far = (p - bounds.min).abs().max((p - bounds.max).abs()).length();
    f64::from(slope / (1.0 - slope.min(0.9)) * far).min(f64::from(slope) * ray.t_max) as f32
}

/// The ray to another point of the disc; `offset` in radii.
pub(crate) fn toward(ray: &LightRay, [right, up]: [DVec3; 2], slope: f32, offset: Vec2) -> LightRay {
    let aside = f64::from(slope * offset.x) * right + f64::from(slope * offset.y) * up;
    let direction = ray.direction + aside;
    let length = direction.length();
    LightRay { direction: direction / length, t_max: ray.t_max * length }
}

/// Rays and cones of a picture, counted by all threads.
#[derive(Debug, Default)]
pub(crate) struct RayCounters {
    rays: AtomicU64,
    far_rays: AtomicU64,
}

impl RayCounters {
    /// Counters that start at these numbers of rays and cones, and of those that entered the far field.
    pub(crate) fn new([rays, far_rays]: [u64; 2]) -> Self {
        Self { rays: rays.into(), far_rays: far_rays.into() }
    }

    pub(crate) fn add(&self, work: LightWork) {
        self.rays.fetch_add(u64::from(work.rays), Ordering::Relaxed);
        self.far_rays.fetch_add(u64::from(work.far_rays), Ordering::Relaxed);
    }

    /// Number of rays and cones, and of those that entered the far field.
    pub(crate) fn counts(&self) -> [u64; 2] {
        [&self.rays, &self.far_rays].map(|count| count.load(Ordering::Relaxed))
    }
}
