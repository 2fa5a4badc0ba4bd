//! The renderer: it draws pictures of a scene, and keeps what they have in common.
//!
//! On a graphics device the fields, meshes, textures and rows of a scene stay in device memory between frames
//! ([`super::device::device_scene`]). A frame with other transforms or materials is a scene of its own that shares the
//! objects ([`Scene::moved`]), so its picture is the one that a new renderer would draw. Only rows that differ from the
//! rows of the frame before are uploaded.
//!
//! On the CPU the trees of the meshes and the fields are parts of the scene.
//!
//! A stage runs again only if something that it depends on has changed ([`super::last_picture`]): a frame of the same
//! scene and camera has the surfaces of the frame before, and with lights of the same places and sizes also the light
//! on them. Then only the colours are computed.

use super::device::device_raster;
use super::last_picture::{LastPicture, LightInputs, SurfaceInputs};
use super::lighting::compose::{LitPass, divide_by_opacity};
use super::lighting::evaluation;
use super::uneven;
use super::visibility::primary;
use crate::error::{Error, SceneError};
use crate::gpu::buffer::Counters;
use crate::gpu::{Context, Place};
use crate::memory::require_for;
use crate::picture::{Camera, Frame, MAX_LIGHTS};
use crate::progress::Progress;
use crate::scene::content::model::Scene;
use crate::scene::content::options::{MAX_BOUNCES, Primary, RenderOptions, SceneShadows};
use crate::scene::device::device_scene::DeviceScene;
use crate::scene::light::bounces::Bounces;
use crate::scene::light::far_field::Far;
use crate::scene::light::light_rays::RayCounters;
use crate::scene::light::lit_surface::Lights;
use crate::scene::light::shadow::TracedScene;
use crate::scene::lighting::light_buffer::LightBuffer;
use crate::scene::lighting::pass::Pass;
use crate::scene::visibility::gbuffer::{GBuffer, Pixels};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Draws frames of one scene, or of scenes that share most of their objects.
pub struct Renderer {
    keeps_pictures: bool,
    /// A frame takes this out, so two frames at the same time do not wait for each other; the second one uploads the
    /// scene again.
    last: Mutex<Last>,
    /// Transfers of all frames.
    counters: Arc<Counters>,
}

/// Data of the last frame.
#[derive(Default)]
struct Last {
    /// The scene on the device.
    device: Option<DeviceScene>,
    picture: Option<LastPicture>,
}

impl Renderer {
    /// A renderer without data. With `keeps_pictures` a frame uses the surfaces and the light of the frame before where
    /// they are the same.
    pub fn new(keeps_pictures: bool) -> Self {
        Self { keeps_pictures, last: Mutex::default(), counters: Arc::default() }
    }

    /// Transfers of all frames.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Draws a scene. On a graphics device both passes run there; [`device_raster`] lists the surfaces that the CPU
    /// draws. The light pass runs there only if the device supports all objects in the scene.
    pub fn frame(
        &self,
        place: &Place,
        scene: &Arc<Scene>,
        camera: &Camera,
        options: &RenderOptions,
        progress: &Progress,
    ) -> Result<Rendered, Error> {
        check(scene, options)?;
        let [width, height] = options.size.map(u64::from);
        let what = format!("a picture of {width} x {height} pixels");
        require_for(&what, PIXEL_BYTES * width * height, 0, "draw fewer pixels")?;
        let far = options.far.as_ref().map(|far| Far::new(scene, far)).transpose()?;
        let surfaces = SurfaceInputs::new(place, scene, camera, options);
        let task = Task { scene, far: far.as_ref(), surfaces, options, progress };
        let Last { device, picture } = std::mem::take(&mut *self.last());
        let (drawn, device) = match place {
            Place::Cpu => (draw(task, None, picture), device),
            Place::Gpu(context) => {
                let start = Instant::now();
                let mut device = self.on_device(device, context, scene, task.far)?;
                let upload = start.elapsed().as_secs_f64();
                (draw_timed(task, context, &mut device, picture, upload), Some(device))
            }
        };
        let (rendered, picture) =
            drawn.map_or_else(|error| (Err(error), None), |(rendered, last)| (Ok(rendered), Some(last)));
        *self.last() = Last { device, picture: picture.filter(|picture| self.keeps_pictures && picture.is_small()) };
        rendered
    }

    /// The scene in the memory of a device.
    fn on_device(
        &self,
        last: Option<DeviceScene>,
        context: &Context,
        scene: &Scene,
        far: Option<&Far>,
    ) -> Result<DeviceScene, Error> {
        if let Some(mut device) = last.filter(|device| device.context().is_same_device(context)) {
            device.update(scene, far)?;
            return Ok(device);
        }
        DeviceScene::upload(&context.counted_by(&self.counters), scene, far)
    }

    fn last(&self) -> MutexGuard<'_, Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A picture, the duration of its passes in seconds, and its counters.
#[derive(Debug)]
pub struct Rendered {
    /// The picture.
    pub frame: Frame,
    /// Number of rays and cones of the light in each pixel, through its centre.
    pub pixel_rays: Vec<u32>,
    /// Whether surfaces were found on the device, and on the CPU.
    pub primary_on: [bool; 2],
    /// Duration of each stage by name: the upload of changes to a device, and the passes.
    pub seconds: Vec<(&'static str, f64)>,
    /// Time of each stage on a device with timestamps: the primary pass, and the kernels of the light.
    pub device_seconds: Vec<(&'static str, f64)>,
    /// Number of rays and cones to lights and surroundings.
    pub rays: u64,
    /// Number of rays and cones that entered the far field.
    pub far_rays: u64,
    /// Number of instances whose triangles the CPU traced for light.
    pub sheets: usize,
    /// Whether the light pass ran on the device.
    pub is_lit_on_device: bool,
    /// Whether the surfaces, and the light on them, are reused from the last picture.
    pub reused: [bool; 2],
}

/// A picture to draw.
struct Task<'a> {
    scene: &'a Scene,
    far: Option<&'a Far>,
    surfaces: SurfaceInputs,
    options: &'a RenderOptions,
    progress: &'a Progress,
}

/// Draws a scene on the device that has it, with the times of the stages there. `upload` is the time of the upload, s.
fn draw_timed(
    task: Task<'_>,
    context: &Context,
    device: &mut DeviceScene,
    last: Option<LastPicture>,
    upload: f64,
) -> Result<(Rendered, LastPicture), Error> {
    if let Some(timer) = &device.timer {
        timer.start();
    }
    // After an error some submissions may still run, so the times are not read.
    let (mut rendered, picture) = draw(task, Some(device), last)?;
    match device.timer.as_ref().map(|timer| timer.finish(context)) {
        None => {}
        Some(Ok(times)) => rendered.device_seconds = times,
        // The picture is kept without its times.
        Some(Err(_)) => device.timer = None,
    }
    rendered.seconds.insert(0, ("upload", upload));
    Ok((rendered, picture))
}

/// The surfaces of a pass and their light.
struct Layers {
    buffer: GBuffer,
    direct: LightBuffer,
    indirect: Option<LightBuffer>,
    /// Counters of the light up to `direct`.
    rays: [u64; 2],
}

/// The passes of one picture.
struct Passes<'a> {
    traced: &'a TracedScene<'a>,
    camera: &'a Camera,
    lights: &'a Lights,
    bounces: Option<&'a Bounces<'a>>,
    options: &'a RenderOptions,
    device: Option<&'a DeviceScene>,
    counters: RayCounters,
    /// Duration of each stage by name: surfaces, light, and bounces if there are any.
    seconds: Vec<(&'static str, f64)>,
    progress: &'a Progress,
}

impl Passes<'_> {
    /// The device of the light, if it has all fields.
    fn light_device(&self) -> Option<&DeviceScene> {
        self.device.filter(|device| device.has_all_fields())
    }

    /// Finds the surfaces of the `chosen` pixels, or of all, through the point `offset` of each pixel, and their light.
    /// Given surfaces and given light are not computed again. Light is interpolated from a pass through the centres.
    fn find(
        &mut self,
        offset: [f64; 2],
        chosen: Option<&Pixels>,
        (buffer, direct): (Option<GBuffer>, Option<LightBuffer>),
        centre: Option<&Layers>,
    ) -> Result<Layers, Error> {
        let &mut Self { traced, camera, options, device, progress, .. } = self;
        let start = Instant::now();
        let buffer = match (buffer, device) {
            (Some(buffer), _) => buffer,
            (None, None) => primary::draw(traced.scene, camera, options, offset, chosen, progress)?,
            (None, Some(device)) => {
                device_raster::draw(traced.scene, device, camera, options, offset, chosen, progress)?
            }
        };
        self.seconds[0].1 += start.elapsed().as_secs_f64();
        let start = Instant::now();
        let pass = self.pass(&buffer);
        let direct = match direct {
            Some(direct) => direct,
            None => evaluation::find(&pass, centre.map(|centre| (&centre.buffer, &centre.direct)))?,
        };
        let rays = self.counters.counts();
        let lit = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let centre = centre.and_then(|centre| Some((&centre.buffer, centre.indirect.as_ref()?)));
        let indirect = self.bounces.map(|bounces| evaluation::find_bounces(&pass, bounces, centre)).transpose()?;
        self.seconds[1].1 += lit;
        self.seconds.iter_mut().skip(2).for_each(|stage| stage.1 += start.elapsed().as_secs_f64());
        Ok(Layers { buffer, direct, indirect, rays })
    }

    fn pass<'b>(&'b self, buffer: &'b GBuffer) -> Pass<'b> {
        Pass {
            traced: self.traced,
            buffer,
            lights: self.lights,
            bounces: None,
            options: self.options,
            device: self.light_device(),
            counters: &self.counters,
            progress: self.progress,
        }
    }

    /// Calls `shade` for the layers of a pass, and adds its time to the time of the light.
    fn shaded<T>(&mut self, layers: &Layers, shade: impl FnOnce(&LitPass<'_>) -> Result<T, Error>) -> Result<T, Error> {
        let start = Instant::now();
        let pass = self.pass(&layers.buffer);
        let shaded = shade(&LitPass { pass: &pass, direct: &layers.direct, indirect: layers.indirect.as_ref() });
        self.seconds[1].1 += start.elapsed().as_secs_f64();
        shaded
    }
}

/// Draws a scene on the CPU, or on the device that has it. The picture uses the surfaces and the light of the last one
/// if they are the same. Its own are returned for the next picture.
fn draw(
    task: Task<'_>,
    device: Option<&DeviceScene>,
    last: Option<LastPicture>,
) -> Result<(Rendered, LastPicture), Error> {
    let Task { scene, far, surfaces, options, progress } = task;
    let camera = &surfaces.camera;
    let sides = (options.samples as f64).sqrt().round() as u32;
    let count = if sides == 1 { 1 } else { 1 + sides * sides };
    let light_of = LightInputs::new(options);
    let (last, light_rays) = match last.filter(|last| last.surfaces_of == surfaces) {
        None => ((None, None), [0; 2]),
        Some(last) if last.light_of == light_of => ((Some(last.buffer), Some(last.light)), last.rays),
        // The passes of the samples have overwritten the surfaces of the centres on the device.
        Some(_) if device.is_some() && sides > 1 => ((None, None), [0; 2]),
        Some(last) => ((Some(last.buffer), None), [0; 2]),
    };
    let reused = [last.0.is_some(), last.1.is_some()];
    // Each pass advances the progress by one for each row in which it finds surfaces, by more for each row in which it
    // finds their light, and by one for each row that it shades. A frame that reuses both shades only. The samples of
    // pixels beside edges, found after the first ones, are not counted.
    let draws = u64::from(count) - u64::from(reused[0]);
    let finds = evaluation::find_count(options, count, reused[1]);
    let shades = u64::from(count);
    progress.set_total((draws + finds * evaluation::ROW_PROGRESS + shades) * u64::from(options.size[1]));

    if options.shadows != SceneShadows::None || options.occlusion.is_some() || options.bounces.is_some() {
        scene.prepare_rays();
    }
    let traced = TracedScene { scene, far, near: None };
    let lights = Lights::new(scene, options);
    let bounces = Bounces::new(&traced, &lights, options, progress)?;
    let mut seconds = vec![("primary", 0.0), ("light", 0.0)];
    seconds.extend(bounces.is_some().then_some(("bounces", 0.0)));
    let mut passes = Passes {
        traced: &traced,
        camera,
        lights: &lights,
        bounces: bounces.as_ref(),
        options,
        device,
        counters: RayCounters::new(light_rays),
        seconds,
        progress,
    };
    let centre = passes.find([0.5, 0.5], None, last, None)?;
    let (mut frame, pixel_rays) = passes.shaded(&centre, |lit| lit.compose())?;
    if sides > 1 {
        uneven::sample(&mut frame, sides, |offset, chosen| {
            let layers = passes.find(offset, Some(chosen), (None, None), Some(&centre))?;
            passes.shaded(&layers, |lit| lit.colors(chosen))
        })?;
    }
    if options.background[3] < 1.0 {
        divide_by_opacity(&mut frame.color, options);
    }
    let primary_on = match device {
        None => [false, true],
        Some(device) => [true, device_raster::drawn_on_cpu(scene, device, options).is_some()],
    };
    let [all_rays, far_rays] = passes.counters.counts();
    let is_lit_on_device = passes.light_device().is_some();
    let seconds = passes.seconds;
    let Layers { buffer, direct: light, rays, .. } = centre;
    let picture = LastPicture { surfaces_of: surfaces, light_of, buffer, light, rays };
    let rendered = Rendered {
        frame,
        pixel_rays,
        primary_on,
        sheets: scene.sheets.len(),
        is_lit_on_device,
        reused,
        seconds,
        device_seconds: Vec::new(),
        rays: all_rays,
        far_rays,
    };
    Ok((rendered, picture))
}

/// Memory of the surfaces of a picture, their light and the images, bytes for each pixel.
const PIXEL_BYTES: u64 = 256;

/// Largest number of pixels of a picture, as for volumes.
const MAX_PIXELS: u64 = 1 << 28;

fn check(scene: &Scene, options: &RenderOptions) -> Result<(), Error> {
    let error = |what: &str, problem: String| Err(SceneError::new(what, problem).into());
    let [width, height] = options.size;
    if width == 0 || height == 0 || u64::from(width) * u64::from(height) > MAX_PIXELS {
        return error("size", format!("expected 1 to {MAX_PIXELS} pixels, got {width} x {height}"));
    }
    if options.lights.len() > MAX_LIGHTS {
        return error("lights", format!("at most {MAX_LIGHTS}, got {}", options.lights.len()));
    }
    let sides = (f64::from(options.samples)).sqrt().round() as u32;
    if options.samples == 0 || options.samples > 64 || sides * sides != options.samples {
        return error("samples", format!("must be a square number from 1 to 64, got {}", options.samples));
    }
    if !(1..=2).contains(&options.light_scale) {
        return error("light_scale", format!("must be 1 or 2, got {}", options.light_scale));
    }
    if let Some(bounces) = &options.bounces {
        if !(1..=MAX_BOUNCES).contains(&bounces.count) || bounces.samples == 0 {
            let problem = format!("must be 1 to {MAX_BOUNCES} with at least one path, got {bounces:?}");
            return error("bounces", problem);
        }
        if options.occlusion.is_some() {
            return error("ambient_occlusion", "bounces contain the occlusion already; leave it out".to_owned());
        }
    }
    for instance in scene.instances.iter().filter(|instance| instance.visible) {
        let i = instance.object;
        if options.primary == Primary::Raster && instance.triangles.is_none() {
            return error(
                "primary",
                format!("instances[{i}] has no triangles to raster; use \"auto\" or \"raymarch\""),
            );
        }
        if options.primary == Primary::Raymarch && instance.field.is_none() {
            return error("primary", format!("instances[{i}] has no field to march; use \"auto\" or \"raster\""));
        }
    }
    Ok(())
}
