//! The raymarcher on a device against the one on the CPU.

use super::camera::tests::look_at;
use super::*;
use crate::gpu::tests::test_context;

/// A sphere, or a bumpy one, on a grid; `center` and `scale` move the world.
fn blob(shape: [usize; 3], bumps: f64, center: DVec3, scale: f64) -> (Grid, Vec<f32>) {
    let grid = Grid::new(center - 1.3 * scale, center + 1.3 * scale, shape).unwrap();
    let distances = (0..grid.len())
        .map(|i| {
            let [nx, ny, _] = shape;
            let p = (grid.center(i % nx, i / nx % ny, i / (nx * ny)) - center) / scale;
            let ripple = bumps * (9.0 * p.x).sin() * (8.0 * p.y).sin() * (7.0 * p.z).sin();
            ((p.length() - 1.0 + ripple) * scale) as f32
        })
        .collect();
    (grid, distances)
}

/// The pictures agree: hits but for one pixel in 10,000, depth to 1e-4 of the diagonal.
fn assert_same_picture(grid: &Grid, distances: &[f32], eye: DVec3, fov_deg: f64, shadows: Shadows) {
    let Some(context) = test_context() else { return };
    let center = 0.5 * (grid.lower + grid.upper);
    let camera = Camera::from_pose(&look_at(eye, center), fov_deg).unwrap();
    let options = RaymarchOptions { size: [160, 128], shadows, ..RaymarchOptions::default() };
    let draw =
        |place: &Place| raymarch_at(place, Source::Host(distances), grid, &camera, &options, &Progress::new()).unwrap();
    let (cpu, gpu) = (draw(&Place::Cpu), draw(&Place::Gpu(context)));
    let pixels = cpu.width * cpu.height;
    let hits = |frame: &Frame| frame.object_id.iter().filter(|&&id| id == 0).count();
    assert!(hits(&cpu) > pixels / 50, "the picture shows {} pixels", hits(&cpu));
    let differ = (0..pixels).filter(|&i| cpu.object_id[i] != gpu.object_id[i]).count();
    assert!(differ <= pixels / 10_000, "{differ} pixels differ");
    let tolerance = 1e-4 * grid.diagonal();
    let (mut shade, mut worst) = (0, 0.0f64);
    for i in (0..pixels).filter(|&i| cpu.object_id[i] == 0 && gpu.object_id[i] == 0) {
        worst = worst.max(f64::from((cpu.depth[i] - gpu.depth[i]).abs()));
        let color = |frame: &Frame, c: usize| frame.color[4 * i + c];
        shade += usize::from((0..3).any(|c| (color(&cpu, c) - color(&gpu, c)).abs() > 1e-2));
    }
    // float32 itself cannot tell depths apart that differ by less than an ulp of the largest.
    let ulp = f64::from(f32::EPSILON) * (eye - center).length();
    assert!(worst <= tolerance + ulp, "depth differs by {worst:e}, allowed {tolerance:e}");
    // At the edge of a shadow, and where the normal jumps between cells, a rounding shows.
    assert!(shade <= pixels / 200, "{shade} pixels are shaded differently");
}

#[test]
fn pictures_agree_with_the_cpu() {
    for (shape, bumps) in [([48, 48, 48], 0.0), ([40, 24, 33], 0.15), ([3, 3, 3], 0.0)] {
        let (grid, distances) = blob(shape, bumps, DVec3::ZERO, 1.0);
        for shadows in [Shadows::Hard, Shadows::None] {
            assert_same_picture(&grid, &distances, DVec3::new(1.5, 2.0, 3.0), 45.0, shadows);
        }
        // The eye in the box, but not in the solid.
        assert_same_picture(&grid, &distances, DVec3::new(0.0, 0.2, 1.25), 80.0, Shadows::Hard);
    }
}

#[test]
fn pictures_agree_far_from_the_origin_and_from_afar() {
    let center = DVec3::new(1e5, -2e5, 3e4);
    let (grid, distances) = blob([32, 32, 32], 0.1, center, 1e-3);
    assert_same_picture(&grid, &distances, center + DVec3::new(1e-3, 2e-3, 3e-3), 45.0, Shadows::Hard);
    let (grid, distances) = blob([32, 32, 32], 0.1, DVec3::ZERO, 1.0);
    assert_same_picture(&grid, &distances, DVec3::new(3e4, 4e4, 0.0), 0.003, Shadows::Hard);
}

#[test]
fn a_field_in_slabs_is_drawn_by_the_texture_hardware() {
    let Some(context) = test_context() else { return };
    let (grid, distances) = blob([33, 20, 24], 0.1, DVec3::ZERO, 1.0);
    let camera = Camera::from_pose(&look_at(DVec3::new(1.5, 2.0, 3.0), DVec3::ZERO), 45.0).unwrap();
    let options = RaymarchOptions { size: [64, 48], filter: Filter::Hardware, ..RaymarchOptions::default() };
    let draw = |max_bytes: u64| {
        let field = DeviceField::allocate(&context, grid.shape, max_bytes).unwrap();
        for slab in field.slabs() {
            let plane = 33 * 20;
            context
                .fill("a slab", &slab.buffer, &distances[slab.first_plane * plane..][..slab.planes * plane])
                .unwrap();
        }
        (field.slabs().len(), raymarch_on_device(&field, &grid, &camera, &options, &Progress::new()).unwrap())
    };
    let ((one, whole), (many, cut)) = (draw(u64::MAX), draw(33 * 20 * 4 * 8));
    assert_eq!((one, many), (1, 3));
    assert!(whole.object_id.contains(&0));
    assert_eq!(whole, cut);
}

#[test]
fn a_solid_cut_by_the_box_shows_the_cut() {
    let (mut grid, distances) = blob([24, 24, 24], 0.0, DVec3::ZERO, 1.0);
    // The same samples in a smaller box read as a sphere that sticks out of it.
    let distances: Vec<f32> = distances.iter().map(|d| d - 0.5).collect();
    grid.upper *= 0.8;
    grid.lower *= 0.8;
    assert_same_picture(&grid, &distances, DVec3::new(1.5, 2.0, 3.0), 45.0, Shadows::Hard);
}
