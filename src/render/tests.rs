//! Pictures of fields whose surface is known in closed form.

use super::*;
use crate::error::Error;
use crate::grid::Grid;
use crate::picture::camera::tests::look_at;
use crate::picture::{Camera, Frame, Light, RaymarchOptions, Shadows};
use crate::progress::Progress;
use crate::volume::{FieldView, Trilinear};
use glam::{DVec3, Vec3};

/// A field sampled on a grid, prepared for drawing.
struct Scene {
    grid: Grid,
    distances: Vec<f32>,
}

impl Scene {
    fn new(lower: DVec3, upper: DVec3, shape: [usize; 3], distance: impl Fn(DVec3) -> f64) -> Self {
        let grid = Grid::new(lower, upper, shape).unwrap();
        let mut distances = Vec::with_capacity(grid.len());
        for z in 0..shape[2] {
            for y in 0..shape[1] {
                for x in 0..shape[0] {
                    distances.push(distance(grid.center(x, y, z)) as f32);
                }
            }
        }
        Self { grid, distances }
    }

    fn field(&self) -> FieldView<'_> {
        FieldView::new(self.grid, &self.distances).unwrap()
    }

    fn draw(&self, camera: &Camera, options: &RaymarchOptions) -> Frame {
        raymarch(self.field(), camera, options, &Progress::new()).unwrap()
    }
}

fn camera(eye: [f64; 3], target: [f64; 3], fov_deg: f64) -> Camera {
    Camera::from_pose(&look_at(DVec3::from(eye), DVec3::from(target)), fov_deg).unwrap()
}

fn options(width: u32, height: u32) -> RaymarchOptions {
    RaymarchOptions { size: [width, height], ..Default::default() }
}

fn sphere(n: usize) -> Scene {
    Scene::new(DVec3::splat(-1.25), DVec3::splat(1.25), [n, n, n], |p| p.length() - 1.0)
}

/// First hit of a ray with the sphere of radius 1 at `center`, as a multiple of `direction`.
fn sphere_depth(eye: DVec3, direction: DVec3, center: DVec3, radius: f64) -> Option<f64> {
    let to_eye = eye - center;
    let (a, b, c) = (direction.length_squared(), to_eye.dot(direction), to_eye.length_squared() - radius * radius);
    let discriminant = b * b - a * c;
    (discriminant >= 0.0).then(|| (-b - discriminant.sqrt()) / a)
}

fn p_world(camera: &Camera, frame: &Frame, x: usize, y: usize) -> DVec3 {
    let direction = camera.pixel_direction(x as u32, y as u32, [frame.width as u32, frame.height as u32]);
    camera.eye + frame.depth[x + y * frame.width] as f64 * direction
}

fn normal_at(frame: &Frame, i: usize) -> DVec3 {
    DVec3::new(frame.normal[3 * i] as f64, frame.normal[3 * i + 1] as f64, frame.normal[3 * i + 2] as f64)
}

#[test]
fn a_sphere_has_the_depth_and_normals_of_a_sphere() {
    let scene = sphere(64);
    let camera = camera([1.5, 1.2, 3.0], [0.0, 0.0, 0.0], 45.0);
    let frame = scene.draw(&camera, &options(96, 72));
    // The trilinear field differs from the distance by at most h^2 / 8 times the sum of its second derivatives, which
    // is 2 / r for a sphere, at radius r >= 1 - 2h near the surface.
    let h = 2.5 / 64.0;
    let field_error = h * h / 8.0 * 2.0 / (1.0 - 2.0 * h);
    let mut hits = 0;
    for i in 0..96 * 72 {
        let (x, y) = (i % 96, i / 96);
        let direction = camera.pixel_direction(x as u32, y as u32, [96, 72]);
        let truth = sphere_depth(camera.eye, direction, DVec3::ZERO, 1.0);
        assert_eq!(frame.object_id[i], if frame.depth[i].is_finite() { 0 } else { -1 });
        if frame.depth[i].is_finite() {
            hits += 1;
            let p = p_world(&camera, &frame, x, y);
            assert!((p.length() - 1.0).abs() <= field_error);
            // A slope of the trilinear field is off by up to h / 2 times the second derivatives, on three axes.
            assert!((normal_at(&frame, i) - p.normalize()).length() < 3.0 * h);
            assert_eq!(frame.color[4 * i + 3], 1.0);
        } else {
            assert_eq!(frame.color[4 * i..4 * i + 4], [1.0; 4]);
            // A miss is right unless the ray passes the sphere within the error.
            let inner = sphere_depth(camera.eye, direction, DVec3::ZERO, 1.0 - field_error);
            assert!(truth.is_none() || inner.is_none());
        }
    }
    assert!(hits > 1000);
}

#[test]
fn every_hit_is_a_root_of_the_sampled_field() {
    let scene = Scene::new(DVec3::new(-1.0, -2.0, 5.0), DVec3::new(2.0, 1.0, 6.5), [33, 17, 9], |p| {
        (3.0 * p.x).sin() * (4.0 * p.y).cos() + (5.0 * p.z).sin() + 0.3
    });
    let camera = camera([3.0, 1.0, 9.0], [0.5, -0.5, 5.75], 40.0);
    let frame = scene.draw(&camera, &options(64, 64));
    // Depth is stored in f32: at a depth of 8 that is 5e-7 along the ray; slopes are below 8; plus the field's
    // rounding.
    let tolerance = 8.0 * 8.0 * f32::EPSILON + 16.0 * 33.0 * f32::EPSILON;
    let mut hits = 0;
    for i in (0..64 * 64).filter(|&i| frame.depth[i].is_finite()) {
        let value = scene.field().sample_linear(p_world(&camera, &frame, i % 64, i / 64));
        // The solid is cut by the box: there the value is below zero, and the normal is the face's.
        let is_cut = normal_at(&frame, i).abs().max_element() == 1.0;
        assert!(value.abs() <= tolerance || (is_cut && value < 0.0), "{value}");
        hits += 1;
    }
    assert!(hits > 1000);
}

#[test]
fn a_box_is_exact_on_its_faces() {
    // Faces of a box are planes, which a trilinear field represents exactly away from the edges.
    let scene = Scene::new(DVec3::splat(-1.0), DVec3::splat(1.0), [40, 20, 30], |p| {
        let q = p.abs() - DVec3::new(0.6, 0.5, 0.7);
        q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
    });
    let camera = camera([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], 20.0);
    let frame = scene.draw(&camera, &options(33, 33));
    let center = 16 * 33 + 16;
    for i in [center, center - 5, center + 4 * 33] {
        assert!((frame.depth[i] - 2.3).abs() <= 4.0 * f32::EPSILON * 3.0);
        assert!((normal_at(&frame, i) - DVec3::Z).length() < 1e-5);
    }
}

#[test]
fn scale_and_offset_change_nothing_but_the_depth() {
    let reference = sphere(32);
    let expected = reference.draw(&camera([1.5, 1.0, 3.0], [0.0; 3], 45.0), &options(48, 48));
    for (scale, offset) in [(1e-6, 0.0), (1e-6, 1e-3), (1e6, 0.0), (1.0, 1e6), (1e20, 0.0), (1e-20, 0.0)] {
        let shift = DVec3::splat(offset);
        let grid = Grid::new(shift - 1.25 * scale, shift + 1.25 * scale, [32, 32, 32]).unwrap();
        let distances = reference.distances.iter().map(|d| d * scale as f32).collect();
        let scene = Scene { grid, distances };
        let eye = shift + scale * DVec3::new(1.5, 1.0, 3.0);
        let frame = scene.draw(&camera(eye.to_array(), shift.to_array(), 45.0), &options(48, 48));
        for i in 0..48 * 48 {
            let (depth, truth) = (frame.depth[i] / scale as f32, expected.depth[i]);
            let near_silhouette = normal_at(&expected, i).dot(DVec3::new(1.5, 1.0, 3.0).normalize()) < 0.2;
            // An offset of 1e6 leaves f64 positions 1e-10 apart.
            assert!(near_silhouette || (depth - truth).abs() < 1e-5, "{scale:e} {offset:e}: {depth} {truth}");
        }
        let lit = |frame: &Frame| frame.shadow.iter().sum::<f32>();
        assert!((lit(&frame) - lit(&expected)).abs() <= 4.0);
    }
}

#[test]
fn a_camera_inside_the_box_or_the_solid() {
    let scene = sphere(32);
    // In the box, outside the sphere: the nearest surface is a little over 0.1 away.
    let frame = scene.draw(&camera([0.0, 0.0, 1.12], [0.0, 0.0, 0.0], 30.0), &options(9, 9));
    assert!((frame.depth[40] - 0.12).abs() < 0.01);
    // In the solid: a hit at depth 0, facing the camera.
    let frame = scene.draw(&camera([0.0, 0.0, 0.5], [0.0, 0.0, 0.0], 30.0), &options(9, 9));
    assert!(frame.depth.iter().all(|&depth| depth == 0.0));
    assert!((normal_at(&frame, 40) - DVec3::Z).length() < 1e-6);
    // In a hollow: the wall all round, seen from within.
    let hollow = Scene::new(DVec3::splat(-1.5), DVec3::splat(1.5), [48, 48, 48], |p| (p.length() - 1.2).abs() - 0.2);
    let frame = hollow.draw(&camera([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], 60.0), &options(9, 9));
    assert!((frame.depth[40] - 1.0).abs() < 0.01);
    assert!((normal_at(&frame, 40) - DVec3::Z).length() < 0.1);
    // Looking away: nothing.
    let frame = scene.draw(&camera([0.0, 0.0, 3.0], [0.0, 0.0, 4.0], 30.0), &options(9, 9));
    assert!(frame.depth.iter().all(|depth| depth.is_infinite()) && frame.object_id.iter().all(|&id| id == -1));
}

#[test]
fn a_solid_that_leaves_the_box_is_cut_flat_and_lit() {
    let scene = Scene::new(DVec3::splat(-1.0), DVec3::splat(1.0), [16, 16, 16], |p| p.length() - 1.3);
    let light = Light::sun(DVec3::NEG_Z, Vec3::ONE);
    let options = RaymarchOptions { lights: vec![light], ..options(9, 9) };
    let frame = scene.draw(&camera([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], 10.0), &options);
    assert!((frame.depth[40] - 3.0).abs() < 1e-5);
    assert_eq!(normal_at(&frame, 40), DVec3::Z);
    assert_eq!(frame.shadow[40], 1.0);
}

#[test]
fn a_sphere_casts_its_shadow_on_a_slab() {
    let (center, radius) = (DVec3::new(0.0, 0.45, 0.0), 0.35);
    let scene = Scene::new(DVec3::splat(-1.0), DVec3::splat(1.0), [64, 64, 64], |p| {
        let slab = p.y + 0.5;
        slab.min((p - center).length() - radius)
    });
    let to_light = DVec3::new(-0.3, 1.0, -0.2).normalize();
    let options = RaymarchOptions { lights: vec![Light::sun(-to_light, Vec3::ONE)], ..options(160, 160) };
    let camera = camera([1.0, 2.5, 3.0], [0.0, -0.1, 0.0], 40.0);
    let frame = scene.draw(&camera, &options);

    let voxel = 2.0 / 64.0;
    let (mut dark, mut cap) = (0, 0);
    for i in (0..160 * 160).filter(|&i| frame.depth[i].is_finite()) {
        let p = p_world(&camera, &frame, i % 160, i / 160);
        if (p - center).length() < radius + voxel {
            // Self-shadowing would darken a pixel on a side that faces the light by more than the facets are tilted.
            if (p - center).normalize().dot(to_light) > 0.25 {
                assert_eq!(frame.shadow[i], 1.0, "acne at {p}");
                cap += 1;
            }
        } else if normal_at(&frame, i).y > 0.99 {
            // Distance of the light ray from the centre of the sphere. Within two voxels of the edge either result is
            // valid.
            let to_center = center - p;
            let miss = (to_center - to_center.dot(to_light) * to_light).length();
            if (miss - radius).abs() > 2.0 * voxel {
                assert_eq!(frame.shadow[i], if miss < radius { 0.0 } else { 1.0 }, "shadow at {p}");
                dark += (miss < radius) as usize;
            }
        }
    }
    assert!(dark > 100 && cap > 300, "{dark} {cap}");
}

#[test]
fn shadows_none_lights_everything_that_faces_the_light() {
    let light = Light::sun(DVec3::NEG_Y, Vec3::ONE);
    let lights = vec![light, light];
    let scene = sphere(16);
    let camera = camera([0.0, 0.0, 4.0], [0.0; 3], 45.0);
    let frame = scene.draw(&camera, &RaymarchOptions { lights, shadows: Shadows::None, ..options(8, 6) });
    assert_eq!((frame.lights, frame.shadow.len()), (2, 8 * 6 * 2));
    assert!(frame.shadow.iter().all(|&share| share == 1.0));
    let frame = scene.draw(&camera, &RaymarchOptions { lights: vec![], ..options(8, 6) });
    assert_eq!((frame.lights, frame.shadow.len()), (0, 0));
}

#[test]
fn one_pixel_one_voxel_and_no_surface() {
    let scene = Scene::new(DVec3::splat(-1.0), DVec3::splat(1.0), [1, 1, 1], |_| 1.0);
    let frame = scene.draw(&camera([0.0, 0.0, 4.0], [0.0; 3], 45.0), &options(1, 1));
    assert_eq!((frame.depth[0], frame.object_id[0], frame.normal.as_slice()), (f32::INFINITY, -1, &[0.0; 3][..]));
    let scene = Scene::new(DVec3::splat(-1.0), DVec3::splat(1.0), [1, 1, 1], |_| -1.0);
    let frame = scene.draw(&camera([0.0, 0.0, 4.0], [0.0; 3], 45.0), &options(1, 1));
    assert!((frame.depth[0] - 3.0).abs() < 1e-6);
}

#[test]
fn the_same_bytes_at_any_number_of_threads() {
    let scene = sphere(24);
    let camera = camera([1.0, 1.0, 3.0], [0.0; 3], 45.0);
    let draw = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| scene.draw(&camera, &options(40, 30)))
    };
    assert_eq!(draw(1), draw(3));
}

#[test]
fn senseless_options_are_refused() {
    let scene = sphere(8);
    let camera = camera([0.0, 0.0, 4.0], [0.0; 3], 45.0);
    let message = |options: RaymarchOptions| {
        raymarch(scene.field(), &camera, &options, &Progress::new()).unwrap_err().to_string()
    };
    let light = |direction: DVec3, color: Vec3| vec![Light::sun(direction, color)];
    assert!(message(options(0, 5)).starts_with("size: "));
    assert!(message(options(1 << 20, 1 << 20)).starts_with("size: "));
    assert!(message(RaymarchOptions { ambient: -1.0, ..options(1, 1) }).starts_with("ambient: "));
    assert!(message(RaymarchOptions { color: Vec3::NAN, ..options(1, 1) }).starts_with("color: "));
    assert!(message(RaymarchOptions { specular: f32::NAN, ..options(1, 1) }).starts_with("specular: "));
    assert!(message(RaymarchOptions { shininess: -1.0, ..options(1, 1) }).starts_with("shininess: "));
    for direction in [DVec3::ZERO, DVec3::NAN, DVec3::INFINITY] {
        let options = RaymarchOptions { lights: light(direction, Vec3::ONE), ..options(1, 1) };
        assert!(message(options).starts_with("lights: [0] has the direction "));
    }
    assert!(
        message(RaymarchOptions { lights: light(DVec3::X, Vec3::NAN), ..options(1, 1) })
            .starts_with("lights: [0] has the colour ")
    );
    let lamp = Light::Point { position: DVec3::ONE, color: Vec3::ONE, radius: 0.0, range: None, spot: None };
    assert!(
        message(RaymarchOptions { lights: vec![lamp], ..options(1, 1) }).starts_with("lights: [0] is at a position")
    );
    let many = vec![lamp; 17];
    assert_eq!(message(RaymarchOptions { lights: many, ..options(1, 1) }), "lights: at most 16, got 17");
    assert!(Shadows::from_name("soft").is_err());
    assert_eq!(Shadows::from_name("none"), Ok(Shadows::None));
}

#[test]
fn cancelling_stops_the_picture() {
    let scene = sphere(8);
    let progress = Progress::new();
    progress.cancel();
    let camera = camera([0.0, 0.0, 4.0], [0.0; 3], 45.0);
    assert_eq!(raymarch(scene.field(), &camera, &options(4, 4), &progress), Err(Error::Cancelled));
}
