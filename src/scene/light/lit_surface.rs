//! A visible surface with the light on it: the rays and cones that its light needs, and their evaluation on the CPU.

use super::cone::visible_share;
use super::light_rays::{Hemisphere, LightRay, LightWork, SurfacePoint, basis, disc_point, toward};
use super::occluder::{NearList, bias};
use super::occlusion::{NearOccluders, PATTERNS};
use super::shadow::TracedScene;
use super::transmission;
use super::transmission::NO_LIGHT;
use crate::picture::{Light, Spot};
use crate::scene::content::model::Scene;
use crate::scene::content::options::{RenderOptions, SceneShadows};
use crate::scene::visibility::gbuffer::{GBuffer, Layer};
use glam::{DVec3, Vec3};

/// Distance of the start from the surface in voxels. A field's own surface departs from a smooth one by less than an
/// eighth of a voxel, and half a voxel clears it. A triangle and the field baked from it differ by up to a third of a
/// voxel more.
pub(crate) const BIAS_FIELD: f32 = 0.5;
pub(crate) const BIAS_TRIANGLE: f32 = 1.0;
/// The same for rays over the hemisphere, which graze the surface. Beside the edges of a turned box the trilinear
/// surface has ripples, which a voxel clears.
const BIAS_HEMISPHERE: f32 = 1.0;

/// The lights of a picture in scene space.
#[derive(Debug)]
pub(crate) struct Lights {
    pub lights: Vec<SceneLight>,
}

/// A light in scene space.
#[derive(Debug, Clone, Copy)]
pub(crate) enum SceneLight {
    /// Unit direction to the light.
    Directional { to_light: DVec3, color: Vec3, slope: f32 },
    Point {
        position: DVec3,
        color: Vec3,
        radius: f64,
        /// Range in scene units, with the number of world units in a scene unit; None without falloff.
        falloff: Option<[f64; 2]>,
        spot: Option<Spot>,
    },
}

impl Lights {
    pub(crate) fn new(scene: &Scene, options: &RenderOptions) -> Self {
        let in_scene = |light: &Light| match *light {
            Light::Directional { direction, color, slope } => {
                SceneLight::Directional { to_light: -direction.normalize(), color, slope }
            }
            Light::Point { position, color, radius, range, spot } => SceneLight::Point {
                position: scene.scene_from_world(position),
                color,
                radius: radius / scene.scale,
                falloff: range.map(|range| [range / scene.scale, scene.scale]),
                spot,
            },
        };
        Self { lights: options.lights.iter().map(in_scene).collect() }
    }
}

impl SceneLight {
    /// Whether the light is larger than a point.
    pub(crate) fn has_size(&self) -> bool {
        match *self {
            Self::Directional { slope, .. } => slope > 0.0,
            Self::Point { radius, .. } => radius > 0.0,
        }
    }

    /// The ray to the light from a scene point, the light's angular radius as a slope, and its colour at the point.
    pub(crate) fn seen_from(&self, p: DVec3) -> (LightRay, f32, Vec3) {
        match *self {
            Self::Directional { to_light, color, slope } => {
                (LightRay { direction: to_light, t_max: f64::INFINITY }, slope, color)
            }
            Self::Point { position, color, radius, falloff, spot } => {
                let to_light = position - p;
                let distance = to_light.length().max(1e-12);
                let direction = to_light / distance;
                let share = falloff.map_or(1.0, |[range, scale]| share_at(distance, range, scale))
                    * spot.map_or(1.0, |spot| share_of_cone(&spot, -direction));
                let color = (share.min(f64::MAX) * color.as_dvec3()).min(DVec3::splat(BRIGHTEST)).as_vec3();
                (LightRay { direction, t_max: distance }, (radius / distance) as f32, color)
            }
        }
    }
}

/// Largest colour of a light at a point, so that sums and products with a cosine stay finite in float32.
const BRIGHTEST: f64 = 1e30;

/// Factor of a light's intensity at a distance below its range, both in scene units of `scale` world units:
/// `(1 - (d / range)^4) / d^2` with `d` in world units (glTF extension KHR_lights_punctual).
fn share_at(distance: f64, range: f64, scale: f64) -> f64 {
    if distance >= range {
        return 0.0;
    }
    let world = distance * scale;
    (1.0 - (distance / range).powi(4)) / (world * world)
}

/// Factor of a spot light's intensity in a unit direction: the square of a linear function of the cosine between the
/// outer and the inner angle (KHR_lights_punctual).
fn share_of_cone(spot: &Spot, direction: DVec3) -> f64 {
    let [inner, outer] = spot.cosines;
    let cosine = spot.axis.dot(direction);
    if cosine >= inner {
        1.0
    } else if cosine <= outer {
        0.0
    } else {
        ((cosine - outer) / (inner - outer)).powi(2)
    }
}

/// Rotation of the samples of an area light for each pixel, 0 to 2 pi: interleaved gradient noise (Jimenez, 2014).
pub(crate) fn pixel_turn(x: usize, y: usize) -> f32 {
    let value = 52.982_918 * (0.067_110_56 * x as f32 + 0.005_837_15 * y as f32).fract();
    value.fract() * std::f32::consts::TAU
}

/// Light on a layer, for writing: the fields of [`crate::scene::lighting::light_buffer::LightSample`].
pub(crate) struct LightSampleMut<'a> {
    pub open: &'a mut f32,
    pub shares: &'a mut [f32],
    pub through: &'a mut [[f32; 3]],
}

/// A layer in scene space.
pub(crate) struct LitSurface<'a> {
    pub layer: &'a Layer,
    pub place: SurfacePoint,
    /// World direction of the ray from the eye, of any length.
    direction: DVec3,
    y: usize,
}

impl<'a> LitSurface<'a> {
    /// A layer of row `y`.
    pub(crate) fn new(scene: &Scene, buffer: &GBuffer, y: usize, layer: &'a Layer) -> Self {
        let direction = buffer.view.direction(layer.x, y as u32);
        let mut place = SurfacePoint {
            p: scene.scene_from_world(buffer.view.start(layer.x, y as u32) + layer.depth * direction),
            normal: layer.normal,
            own: layer.instance,
            bias_voxels: if layer.is_triangle { BIAS_TRIANGLE } else { BIAS_FIELD },
            lift: layer.to_smooth,
            skips_own: false,
        };
        let own = &scene.instances[layer.instance as usize];
        if !layer.is_triangle && own.triangles.is_some() {
            // The surface of the field is up to a third of a voxel inside the mesh.
            let off_field = BIAS_TRIANGLE / BIAS_FIELD * bias(own, &place) * place.normal;
            place.lift = (own.tree_from_scene.matrix3 * off_field.as_dvec3()).as_vec3();
        }
        Self { layer, place, direction, y }
    }

    /// Unit direction to the eye.
    pub(crate) fn to_eye(&self) -> Vec3 {
        -self.direction.normalize().as_vec3()
    }

    /// Rotation of the samples of area lights, radians.
    fn turn(&self) -> f32 {
        pixel_turn(self.layer.x as usize, self.y)
    }

    /// The hemisphere for occlusion by occluders within a distance, scene units.
    pub(crate) fn hemisphere(&self, distance: f64) -> Hemisphere {
        let pattern = (self.turn() * (PATTERNS as f32 / std::f32::consts::TAU)) as usize;
        Hemisphere { place: SurfacePoint { bias_voxels: BIAS_HEMISPHERE, ..self.place }, distance, pattern }
    }

    /// Cosine between the normal and a ray.
    pub(crate) fn cosine(&self, ray: &LightRay) -> f32 {
        self.layer.normal.dot(ray.direction.as_vec3())
    }

    /// Whether a light must be evaluated. A surface that faces away from the light receives none of it.
    pub(crate) fn needs_rays(&self, ray: &LightRay, options: &RenderOptions) -> bool {
        options.shadows != SceneShadows::None && self.cosine(ray) > 0.0
    }

    pub(crate) fn scatters(&self, scene: &Scene) -> bool {
        scene.materials[self.layer.material as usize].scattering != [0.0; 3]
    }

    /// Fraction of a light that arrives, where it is known without evaluation: 1 without shadows, 0 on a surface that
    /// faces away. Else None.
    pub(crate) fn plain_share(&self, ray: &LightRay, options: &RenderOptions) -> Option<f32> {
        match options.shadows {
            SceneShadows::None => Some(1.0),
            _ if !self.needs_rays(ray, options) => Some(0.0),
            _ => None,
        }
    }

    /// Limits the visible fraction of a light to the part of its disc above the tangent plane of the surface. A field
    /// and its surface differ by a fraction of a voxel, so cones do not decide this part. Rays of area lights are
    /// limited one by one, see [`SurfacePoint::is_above_horizon`].
    pub(crate) fn above_horizon(&self, share: f32, ray: &LightRay, slope: f32, options: &RenderOptions) -> f32 {
        if options.shadows != SceneShadows::Soft || slope <= 0.0 {
            return share;
        }
        let cosine = self.cosine(ray);
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        // The tangent plane is the edge of an occluder.
        if cosine >= slope * sine { share } else { share.min(visible_share(cosine / (slope * sine))) }
    }

    /// Evaluates the light on the surface in the fields. `near` has for each light the instances that may block it,
    /// if they are known. Returns the work.
    pub(crate) fn evaluate(
        &self,
        traced: &TracedScene<'_>,
        near: Option<&[NearList]>,
        lights: &Lights,
        options: &RenderOptions,
        occluders: &mut NearOccluders,
        found: &mut LightSampleMut<'_>,
    ) -> LightWork {
        let (scene, place, mut work) = (traced.scene, &self.place, LightWork::default());
        *found.open = match options.occlusion {
            None => 1.0,
            Some(distance) => traced.open_share(&self.hemisphere(distance / scene.scale), occluders, &mut work),
        };
        for (i, light) in lights.lights.iter().enumerate() {
            let (ray, slope, _) = light.seen_from(place.p);
            let near = TracedScene { near: near.map(|near| &near[i]), ..*traced };
            found.shares[i] = self.plain_share(&ray, options).unwrap_or_else(|| {
                let share = self.visible_share(&near, place, &ray, slope, options, &mut work);
                self.above_horizon(share, &ray, slope, options)
            });
            found.through[i] = [0.0; 3];
            if self.scatters(scene) {
                let paths = self.paths(&ray, slope, options.shadows);
                let mut sum = Vec3::ZERO;
                for (path, slope) in &paths {
                    let transmitted = self.transmitted(scene, path, traced.length_inside(place, path, &mut work));
                    sum += match self.plain_visibility(found.shares[i], transmitted, options) {
                        Some(share) => share * transmitted,
                        None => {
                            transmitted
                                * self.visible_share(traced, &self.place_behind(), path, *slope, options, &mut work)
                        }
                    };
                }
                found.through[i] = (sum / paths.len() as f32).to_array();
            }
        }
        work
    }

    /// Visible fraction of a light from a place, in the mode of the picture's shadows.
    fn visible_share(
        &self,
        traced: &TracedScene<'_>,
        place: &SurfacePoint,
        ray: &LightRay,
        slope: f32,
        options: &RenderOptions,
        work: &mut LightWork,
    ) -> f32 {
        match options.shadows {
            SceneShadows::None => 1.0,
            SceneShadows::Hard => traced.ray_share(place, ray, work),
            SceneShadows::Soft => traced.disc_share(place, ray, slope, work),
            SceneShadows::Area(count) => traced.area_share(place, ray, slope, count, self.turn(), work),
        }
    }

    /// The rays along which light passes through the instance, each with the slope of its part of the light: every ray
    /// of an area light separately, else the ray to the centre with the whole light.
    pub(crate) fn paths(&self, ray: &LightRay, slope: f32, shadows: SceneShadows) -> Vec<(LightRay, f32)> {
        match shadows {
            SceneShadows::Area(count) if slope > 0.0 => {
                let (axes, turn) = (basis(ray.direction), self.turn());
                (0..count).map(|i| (toward(ray, axes, slope, disc_point(i, count, turn)), 0.0)).collect()
            }
            _ => vec![(*ray, slope)],
        }
    }

    /// Fraction of the light that remains after a length inside the instance, scene units, times the weight of the
    /// surface.
    pub(crate) fn transmitted(&self, scene: &Scene, ray: &LightRay, length: f32) -> Vec3 {
        let scattering = Vec3::from_array(scene.materials[self.layer.material as usize].scattering);
        transmission::weight(self.cosine(ray)) * transmission::transmitted(length * scene.scale as f32, scattering)
    }

    /// The visibility of a light behind the instance if it needs no rays: without shadows, where no light remains, and
    /// where the surface receives all of the light although its own instance can shade it.
    pub(crate) fn plain_visibility(&self, share: f32, transmitted: Vec3, options: &RenderOptions) -> Option<f32> {
        match options.shadows {
            SceneShadows::None => Some(1.0),
            _ if transmitted.max_element() <= NO_LIGHT => Some(0.0),
            _ => (share >= 1.0).then_some(1.0),
        }
    }

    /// The surface point for light through the instance: the instance itself casts no shadow on it.
    pub(crate) fn place_behind(&self) -> SurfacePoint {
        SurfacePoint { skips_own: true, ..self.place }
    }
}
