//! The visible triangles of opaque meshes, found on the CPU without a ray for each pixel and mesh.
//!
//! # Theory
//!
//! In camera space, with the axes right, up and depth and the eye at the origin, the ray of a pixel is `d = (x, y, 1)`.
//! It intersects the face `a, b, c` where `d.(b x c)`, `d.(c x a)` and `d.(a x b)` have the sign of `v = a.n`, with
//! `n = (b - a) x (c - a)`, at the depth `v / d.n`. These are linear functions of the pixel, and faces behind the eye
//! need no clipping (Olano and Greer, *Triangle scan conversion using 2D homogeneous coordinates*, 1997).
//!
//! The rasteriser only selects a face. The primary pass intersects it with the ray as it would have done in a search,
//! so the picture is the same bit for bit. Where rounding could change the selection (near an edge, or where two faces
//! have nearly the same depth) the pixel is marked, and the primary pass searches the scene.
//!
//! # Practice
//!
//! Meshes with a mask or a translucent material, strongly stretched ones, and those with more than [`FACES_PER_PIXEL`]
//! faces per pixel of their rectangle on the screen are left to the search, as are all fields, and all meshes if the
//! rays are parallel. Rays are traced in the pixels that their boxes cover, or for large fields in the tiles of their
//! surface ([`super::searched`]).
//! Rows are drawn in bands, in parallel.

use super::gbuffer::{Layer, View};
use super::pixel_ray::{PixelRay, as_triangles, is_opaque};
use super::searched::{PixelRectangle, SearchedInstances, tiles_of};
use crate::error::Error;
use crate::progress::Progress;
use crate::scene::content::instance::Instance;
use crate::scene::content::material::Alpha;
use crate::scene::content::model::Scene;
use crate::scene::content::options::RenderOptions;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;
use std::ops::Range;

/// Number of rows of a band.
pub(crate) const BAND_ROWS: u32 = 16;

/// Bound of the rounding errors of a position in camera space, relative to the distances of the eye and the position:
/// 180 units of rounding. The inverse of a transform has at most [`MOST_STRETCH`] times the rounding of its products.
const ROUNDING: f64 = 4e-14;
/// Depth, relative to the distance of the eye, below which a position is not projected.
const NEAR: f64 = 1e-9;
/// Relative difference between depths below which the order of two faces is not decided here.
const SAME_DEPTH: f64 = 1e-7;
/// Largest ratio of the singular values of a transform for which [`ROUNDING`] holds.
const MOST_STRETCH: f32 = 16.0;
/// Largest number of faces per pixel of the screen rectangle of a mesh. A search through its tree is quicker beyond it.
const FACES_PER_PIXEL: usize = 4;
/// Margin of boxes in scene space, more than their rounding to float32.
const BOX_MARGIN: f32 = 1e-6;
/// Margin of rectangles on the screen, pixels.
const PIXEL_MARGIN: f64 = 0.01;

/// The nearest face of a pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VisibleFace {
    /// Depth in scene units; infinite without a face.
    depth: f64,
    /// Smallest depth of a face for which rounding decides whether it is visible.
    unsure: f64,
    item: u32,
    face: u32,
}

const NOTHING: VisibleFace = VisibleFace { depth: f64::INFINITY, unsure: f64::INFINITY, item: 0, face: 0 };

impl VisibleFace {
    fn is_unsure(&self) -> bool {
        self.unsure < f64::INFINITY && self.unsure <= self.depth * (1.0 + SAME_DEPTH)
    }

    /// Adds a face that covers the pixel beyond any rounding error.
    #[inline]
    fn add(&mut self, depth: f64, item: u32, face: u32) {
        let (near, far) = if depth < self.depth { (depth, self.depth) } else { (self.depth, depth) };
        if far <= near * (1.0 + SAME_DEPTH) {
            self.unsure = self.unsure.min(near);
        }
        if depth < self.depth {
            (self.depth, self.item, self.face) = (depth, item, face);
        }
    }
}

/// A mesh instance in camera space.
struct RasterMesh<'a> {
    item: u32,
    corners: Vec<DVec3>,
    faces: &'a [[u32; 3]],
    /// Faces that may be visible, with their rectangles.
    kept: Vec<(u32, PixelRectangle)>,
    rows: Range<u32>,
}

/// The meshes of a scene in a view.
pub(crate) struct Rasterizer<'a> {
    screen: Screen,
    meshes: Vec<RasterMesh<'a>>,
    searched: SearchedInstances,
}

impl<'a> Rasterizer<'a> {
    pub(crate) fn new(
        scene: &'a Scene,
        options: &RenderOptions,
        view: &View,
        progress: &Progress,
    ) -> Result<Self, Error> {
        let screen = Screen::new(scene, view);
        let (mut searched, mut drawn) = (SearchedInstances::new(scene.instances.len()), Vec::new());
        for (i, instance) in scene.instances.iter().enumerate().filter(|(_, instance)| instance.visible) {
            let bounds = &scene.boxes[i];
            let Some(rectangle) = screen.rectangle_of_box(bounds.min - BOX_MARGIN, bounds.max + BOX_MARGIN) else {
                continue;
            };
            let pixels = rectangle[0].len() * rectangle[1].len();
            if !screen.is_parallel && is_rasterised(scene, instance, options, FACES_PER_PIXEL * pixels) {
                drawn.push(i as u32);
            } else {
                let tiles = match as_triangles(instance, options.primary) || !searched.may_have_more_tiles() {
                    true => None,
                    false => tiles_of(scene, instance, view, pixels, progress)?,
                };
                searched.add(i, rectangle, tiles);
            }
        }
        let meshes = drawn.into_par_iter().map(|item| screen.mesh(scene, item)).collect();
        Ok(Self { screen, meshes, searched })
    }

    /// The nearest faces of the pixels of some rows.
    pub(crate) fn band(&self, rows: Range<u32>) -> Vec<VisibleFace> {
        let width = self.screen.size[0];
        let mut visible = vec![NOTHING; width as usize * rows.len()];
        for mesh in self.meshes.iter().filter(|mesh| overlap(&mesh.rows, &rows).is_some()) {
            for (face, [columns, face_rows]) in &mesh.kept {
                if let Some(part) = overlap(face_rows, &rows) {
                    let corners = mesh.faces[*face as usize].map(|vertex| mesh.corners[vertex as usize]);
                    let target = Target { visible: &mut visible, first_row: rows.start, width };
                    self.screen.fill(corners, [columns.clone(), part], target, mesh.item, *face);
                }
            }
        }
        visible
    }

    /// For each pixel of a row, whether its ray must search instances.
    pub(crate) fn searched(&self, y: u32) -> Vec<bool> {
        let mut columns = vec![false; self.screen.size[0] as usize];
        self.searched.mark_row(y, &mut columns);
        columns
    }

    /// Appends the layers of a pixel. `is_searched` is its entry of [`Self::searched`].
    pub(crate) fn resolve<'b>(
        &'b self,
        ray: &mut PixelRay<'b>,
        visible: &VisibleFace,
        is_searched: bool,
        layers: &mut Vec<Layer>,
    ) {
        if visible.is_unsure() {
            return ray.trace(layers, None);
        }
        let mut behind = None;
        if visible.depth < f64::INFINITY {
            behind = ray.face(visible.item, visible.face);
            if behind.is_none() {
                return ray.trace(layers, None);
            }
            ray.steps += 1;
        }
        if !is_searched {
            layers.extend(behind);
            return;
        }
        let first = layers.len();
        ray.limit_to(Some(&self.searched));
        ray.trace(layers, behind);
        // At equal depths the order of the search decides.
        let is_tie = |layer: &Layer| {
            behind.is_some_and(|behind| layer.instance != behind.instance && layer.depth == behind.depth)
        };
        if layers[first..].iter().any(is_tie) {
            layers.truncate(first);
            ray.limit_to(None);
            ray.trace(layers, None);
        }
    }
}

/// Whether the rasteriser draws an instance.
fn is_rasterised(scene: &Scene, instance: &Instance, options: &RenderOptions, most_faces: usize) -> bool {
    let Some(triangles) = instance.triangles.as_ref().filter(|_| as_triangles(instance, options.primary)) else {
        return false;
    };
    let is_plain = |material: &crate::scene::content::material::Material| {
        material.alpha == Alpha::Opaque && is_opaque(instance, material)
    };
    triangles.mesh.faces().len() <= most_faces
        && instance.stretch[1] <= MOST_STRETCH * instance.stretch[0]
        && instance.own_materials(&scene.materials).iter().all(is_plain)
}

fn overlap(a: &Range<u32>, b: &Range<u32>) -> Option<Range<u32>> {
    let both = a.start.max(b.start)..a.end.min(b.end);
    (both.start < both.end).then_some(both)
}

/// The pixels of a band.
struct Target<'a> {
    visible: &'a mut [VisibleFace],
    first_row: u32,
    width: u32,
}

/// Camera space and the pixels in it.
struct Screen {
    camera_from_scene: DAffine3,
    is_parallel: bool,
    size: [u32; 2],
    /// Side of a pixel at depth 1, or in scene units if the rays are parallel, and the ray through pixel (0, 0).
    pixel: f64,
    first: [f64; 2],
    /// Largest length of a ray at depth 1.
    longest: f64,
    /// Distance of the eye from the origin of scene space, plus the size of the scene.
    reach: f64,
}

impl Screen {
    fn new(scene: &Scene, view: &View) -> Self {
        let camera = &view.camera;
        let eye = scene.scene_from_world(camera.eye);
        // The axes of a camera are perpendicular only within a tolerance.
        let linear = DMat3::from_cols(camera.right, camera.up, -camera.back).inverse();
        let is_parallel = camera.is_parallel();
        let pixel = camera.pixel_size(view.size[1]) / if is_parallel { scene.scale } else { 1.0 };
        let [width, height] = view.size.map(f64::from);
        let first = [(view.offset[0] - 0.5 * width) * pixel, (0.5 * height - view.offset[1]) * pixel];
        Self {
            camera_from_scene: DAffine3::from_mat3_translation(linear, -(linear * eye)),
            is_parallel,
            size: view.size,
            pixel,
            first,
            longest: DVec3::new(0.5 * width * pixel + pixel, 0.5 * height * pixel + pixel, 1.0).length(),
            reach: eye.length() + 1.0,
        }
    }

    /// Column and row, in fractions of pixels, of a position in front of the eye.
    fn project(&self, p: DVec3) -> [f64; 2] {
        let depth = if self.is_parallel { self.pixel } else { p.z * self.pixel };
        [p.x / depth - self.first[0] / self.pixel, self.first[1] / self.pixel - p.y / depth]
    }

    /// The pixels that a set of positions may cover: their rectangle, all pixels if some positions are behind the eye,
    /// or none.
    fn rectangle(&self, points: &[DVec3]) -> Option<PixelRectangle> {
        let [width, height] = self.size;
        let near = NEAR * self.reach;
        if points.iter().all(|p| p.z < -near) {
            return None;
        }
        if points.iter().any(|p| p.z <= near) {
            return Some([0..width, 0..height]);
        }
        let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for &p in points {
            for (range, value) in range.iter_mut().zip(self.project(p)) {
                *range = [range[0].min(value), range[1].max(value)];
            }
        }
        // A conversion to u32 saturates.
        let pixels = |[low, high]: [f64; 2], size: u32| {
            let first = (low - PIXEL_MARGIN).ceil().max(0.0) as u32;
            first..((high + PIXEL_MARGIN).floor() + 1.0).max(0.0).min(f64::from(size)) as u32
        };
        let [columns, rows] = [pixels(range[0], width), pixels(range[1], height)];
        (columns.start < columns.end && rows.start < rows.end).then_some([columns, rows])
    }

    fn rectangle_of_box(&self, min: Vec3, max: Vec3) -> Option<PixelRectangle> {
        let corners: [DVec3; 8] = std::array::from_fn(|i| {
            let pick = |axis: usize| f64::from(if i >> axis & 1 == 0 { min[axis] } else { max[axis] });
            self.camera_from_scene.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
        });
        self.rectangle(&corners)
    }

    fn mesh<'a>(&self, scene: &'a Scene, item: u32) -> RasterMesh<'a> {
        let instance = &scene.instances[item as usize];
        let triangles = instance.triangles.as_ref().expect("only meshes are rasterised");
        let camera_from_tree = self.camera_from_scene * instance.tree_from_scene.inverse();
        let place = |vertex: u32| camera_from_tree.transform_point3(triangles.mesh.exact_position(vertex));
        let corners: Vec<DVec3> = (0..triangles.mesh.positions().len() as u32).map(place).collect();
        let faces = triangles.mesh.faces();
        let is_mirrored = camera_from_tree.matrix3.determinant() < 0.0;
        let materials = instance.own_materials(&scene.materials);
        let mut kept = Vec::new();
        let (mut first_row, mut end_row) = (u32::MAX, 0);
        for (face, vertices) in faces.iter().enumerate() {
            let abc = vertices.map(|vertex| corners[vertex as usize]);
            if !materials[triangles.material[face] as usize].two_sided {
                let plane = Plane::new(abc, self.reach);
                // In the mesh's own space, a face and an eye in front of it span a negative volume.
                let volume = if is_mirrored { -plane.volume } else { plane.volume };
                if volume > plane.volume_error {
                    continue;
                }
            }
            if let Some(rectangle) = self.rectangle(&abc) {
                (first_row, end_row) = (first_row.min(rectangle[1].start), end_row.max(rectangle[1].end));
                kept.push((face as u32, rectangle));
            }
        }
        RasterMesh { item, corners, faces, kept, rows: first_row..end_row }
    }

    /// Draws a face into a rectangle of a band.
    fn fill(&self, [a, b, c]: [DVec3; 3], [columns, rows]: PixelRectangle, target: Target<'_>, item: u32, face: u32) {
        let plane = Plane::new([a, b, c], self.reach);
        let is_edge_on = plane.volume.abs() <= plane.volume_error;
        let is_clear = plane.volume.abs() * SAME_DEPTH > plane.volume_error;
        let sign = if plane.volume < 0.0 { -1.0 } else { 1.0 };
        let edges = [sign * b.cross(c), sign * c.cross(a), sign * a.cross(b)];
        let normal = sign * plane.normal;
        let volume = plane.volume.abs();
        let unsure = ROUNDING * plane.distance * plane.distance * self.longest;
        let least_cosine = plane.normal_error * self.longest;
        for y in rows {
            let along_y = self.first[1] - f64::from(y) * self.pixel;
            // Edge i is `at[i] + x * step[i]` at column x.
            let at = edges.map(|edge| self.first[0] * edge.x + along_y * edge.y + edge.z);
            let step = edges.map(|edge| self.pixel * edge.x);
            let span = if is_edge_on { columns.clone() } else { inside(at, step, unsure, columns.clone()) };
            let facing = (self.first[0] * normal.x + along_y * normal.y + normal.z, self.pixel * normal.x);
            let row = &mut target.visible[((y - target.first_row) * target.width) as usize..][..target.width as usize];
            for x in span {
                let column = f64::from(x);
                let value: [f64; 3] = std::array::from_fn(|i| at[i] + column * step[i]);
                let least = value[0].min(value[1]).min(value[2]);
                let pixel = &mut row[x as usize];
                if is_edge_on {
                    let largest = value[0].max(value[1]).max(value[2]);
                    if least >= -unsure || largest <= unsure {
                        pixel.unsure = 0.0;
                    }
                    continue;
                }
                if least < -unsure {
                    continue;
                }
                let cosine = facing.0 + column * facing.1;
                if is_clear && least > unsure && cosine * SAME_DEPTH > least_cosine {
                    pixel.add(volume / cosine, item, face);
                } else {
                    // A lower bound of the depth.
                    pixel.unsure = pixel.unsure.min((volume - plane.volume_error) / (cosine.abs() + least_cosine));
                }
            }
        }
    }
}

/// The columns in which three linear functions are not below `-slack`, enlarged by one on both sides.
fn inside(at: [f64; 3], step: [f64; 3], slack: f64, columns: Range<u32>) -> Range<u32> {
    let (mut low, mut high) = (f64::from(columns.start), f64::from(columns.end));
    for (at, step) in at.into_iter().zip(step) {
        let root = -(at + slack) / step;
        if step > 0.0 {
            low = low.max(root - 1.0);
        } else if step < 0.0 {
            high = high.min(root + 2.0);
        } else if at < -slack {
            return 0..0;
        }
    }
    (low.max(0.0) as u32).max(columns.start)..(high.max(0.0) as u32).min(columns.end)
}

/// The plane of a face, and bounds of rounding errors.
struct Plane {
    normal: DVec3,
    normal_error: f64,
    volume: f64,
    volume_error: f64,
    /// Bound of the distances that rounding errors are relative to.
    distance: f64,
}

impl Plane {
    fn new([a, b, c]: [DVec3; 3], reach: f64) -> Self {
        let (ab, ac) = (b - a, c - a);
        let normal = ab.cross(ac);
        let distance = reach + a.length().max(b.length()).max(c.length());
        let normal_error = ROUNDING * distance * (ab.length() + ac.length());
        Self { normal, normal_error, volume: a.dot(normal), volume_error: normal_error * distance, distance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::Place;
    use crate::picture::Camera;
    use crate::progress::Progress;
    use crate::scene::content::instance::InstanceInput;
    use crate::scene::content::material::Material;
    use crate::scene::content::triangles::Triangles;
    use crate::scene::renderer::Renderer;
    use crate::scene::visibility::pixel_ray::draw_row;
    use crate::scene::visibility::primary::draw;
    use std::sync::Arc;

    /// A grid of quads over the unit square at height 0, with `bumps` of this height.
    fn sheet(side: i64, bumps: f64) -> Arc<Triangles> {
        let at = |i: i64, j: i64| {
            let [x, z] = [i, j].map(|k| 2.0 * k as f64 / side as f64 - 1.0);
            [x, bumps * (7.0 * x).sin() * (5.0 * z).cos(), z]
        };
        let vertices: Vec<_> = (0..=side).flat_map(|i| (0..=side).map(move |j| at(i, j))).collect();
        let index = |i: i64, j: i64| i * (side + 1) + j;
        let quad = |i: i64, j: i64| {
            let [a, b, c, d] = [index(i, j), index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)];
            [[a, b, c], [a, c, d]]
        };
        let faces: Vec<_> = (0..side).flat_map(|i| (0..side).flat_map(move |j| quad(i, j))).collect();
        let count = faces.len();
        Arc::new(
            Triangles::new(Arc::new(crate::mesh::Mesh::new(&vertices, &faces).unwrap()), vec![], vec![0; count])
                .unwrap(),
        )
    }

    fn scene() -> Scene {
        let materials = [(false, Alpha::Opaque), (true, Alpha::Opaque), (true, Alpha::Blend)]
            .map(|(two_sided, alpha)| Material::plain(two_sided, alpha))
            .to_vec();
        let (floor, waves) = (sheet(1, 0.0), sheet(12, 0.1));
        let place = |triangles: &Arc<Triangles>, linear: DMat3, at: DVec3, first_material: u32| InstanceInput {
            triangles: Some(triangles.clone()),
            field: None,
            world_from_local: DAffine3::from_mat3_translation(linear, at),
            first_material,
            own_colors: false,
            opacity: 1.0,
            casts_shadow: true,
            visible: true,
            object: 0,
            is_sheet: true,
            is_solid: false,
        };
        let turned = |angle: f64| DMat3::from_rotation_x(angle) * DMat3::from_rotation_y(1.0 + angle);
        let mut inputs = vec![
            place(&floor, DMat3::from_diagonal(DVec3::splat(4.0)), DVec3::ZERO, 1),
            // Coplanar with the floor, and overlapping it.
            place(&floor, DMat3::IDENTITY, DVec3::new(0.5, 0.0, 0.25), 0),
            place(&waves, turned(0.4), DVec3::new(-1.0, 0.8, 0.0), 2),
            // Too strongly stretched for the rasteriser.
            place(&waves, DMat3::from_diagonal(DVec3::new(1.0, 0.02, 1.0)), DVec3::new(1.5, 1.5, 0.0), 1),
        ];
        for i in 0..12 {
            let angle = f64::from(i);
            let mirror = if i % 3 == 0 { DVec3::new(-0.4, 0.5, 0.6) } else { DVec3::splat(0.5) };
            let at = DVec3::new(2.0 * angle.cos(), 0.3 + 0.1 * angle, 2.0 * angle.sin());
            inputs.push(place(&waves, turned(angle) * DMat3::from_diagonal(mirror), at, i % 2));
        }
        Scene::new(inputs, materials, Vec::new()).unwrap()
    }

    /// A camera that looks at the origin.
    fn camera(eye: DVec3, fov_deg: f64) -> Camera {
        let back = eye.normalize();
        let right = DVec3::Y.cross(back).normalize();
        let up = back.cross(right);
        let row = |i: usize| [right[i], up[i], back[i], eye[i]];
        Camera::from_pose(&[row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]], fov_deg).unwrap()
    }

    /// The rows of every stage count, so the fraction ends at 1 without the addition of the caller.
    #[test]
    fn the_progress_of_a_picture_ends_at_one_with_and_without_reuse() {
        let (scene, renderer) = (Arc::new(scene()), Renderer::new(true));
        let view = camera(DVec3::new(3.0, 2.0, 5.0), 45.0);
        for reused in [[false; 2], [true; 2]] {
            let progress = Progress::new();
            let rendered = renderer.frame(&Place::Cpu, &scene, &view, &RenderOptions::default(), &progress).unwrap();
            assert_eq!((rendered.reused, progress.fraction()), (reused, 1.0));
        }
        let progress = Progress::new();
        progress.cancel();
        assert!(renderer.frame(&Place::Cpu, &scene, &view, &RenderOptions::default(), &progress).is_err());
    }

    /// The rasteriser and the search give the same layers bit for bit, for eyes outside, among the meshes, in the plane
    /// of the floor, and far away.
    #[test]
    fn the_picture_is_that_of_the_search() {
        let (scene, options) = (scene(), RenderOptions::default());
        let eyes = [
            (DVec3::new(3.0, 2.0, 5.0), 45.0),
            (DVec3::new(0.3, 0.9, 0.2), 100.0),
            (DVec3::new(0.0, 5.0, 1e-3), 50.0),
            (DVec3::new(0.0, 0.0, 2.5), 60.0),
            (DVec3::new(0.1, -2.0, 0.4), 70.0),
            (DVec3::new(3000.0, 2000.0, 5000.0), 0.05),
        ];
        for (eye, fov_deg) in eyes {
            let camera = camera(eye, fov_deg);
            for offset in [[0.5, 0.5], [0.25, 0.75]] {
                let drawn = draw(&scene, &camera, &options, offset, None, &Progress::new()).unwrap();
                let view = View { camera, size: options.size, offset };
                let mut count = 0;
                for y in 0..options.size[1] {
                    let (layers, _) = draw_row(&scene, &options, &view, y, |ray, layers| ray.trace(layers, None));
                    assert_eq!(drawn.rows[y as usize], layers, "row {y} from {eye}");
                    count += layers.len();
                }
                assert!(count > 500, "{count} layers from {eye}");
                let rasterizer = Rasterizer::new(&scene, &options, &view, &Progress::new()).unwrap();
                let visible: Vec<VisibleFace> = (0..options.size[1]).flat_map(|y| rasterizer.band(y..y + 1)).collect();
                let unsure = visible.iter().filter(|visible| visible.is_unsure()).count();
                let found = visible.iter().filter(|visible| visible.depth < f64::INFINITY).count();
                assert!(found > 400, "{found} of {unsure} unsure");
            }
        }
    }

    #[test]
    fn a_span_contains_all_columns_inside() {
        // x >= 2.5, x <= 7.25 and a constant.
        let [at, step] = [[-2.5, 7.25, 1.0], [1.0, -1.0, 0.0]];
        let span = inside(at, step, 0.0, 0..100);
        assert!(span.start <= 3 && span.start >= 1 && span.end >= 8 && span.end <= 10, "{span:?}");
        assert!(inside([-1.0, 1.0, 1.0], [0.0; 3], 0.5, 0..100).is_empty());
        assert_eq!(inside([-0.25, 1.0, 1.0], [0.0; 3], 0.5, 3..9), 3..9);
        assert!(inside([5.0, -6.0, 1.0], [-1.0, 1.0, 0.0], 0.0, 0..100).len() <= 3);
    }

    #[test]
    fn close_depths_are_unsure() {
        let mut visible = NOTHING;
        assert!(!visible.is_unsure());
        visible.add(2.0, 1, 7);
        visible.add(3.0, 2, 8);
        assert!(!visible.is_unsure() && (visible.item, visible.face) == (1, 7));
        visible.add(2.0, 3, 9);
        assert!(visible.is_unsure());
        // A nearer face hides both.
        visible.add(1.0, 4, 1);
        assert!(!visible.is_unsure() && visible.item == 4);
        visible.unsure = 0.0;
        assert!(visible.is_unsure());
    }
}
