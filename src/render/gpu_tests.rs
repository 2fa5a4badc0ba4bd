//! The ray marcher on a device against the one on the CPU.

use super::*;
use crate::encoding::Encoding;
use crate::gpu::shader::shared;
use crate::gpu::tests::test_context;
use crate::gpu::{Place, layout};
use crate::grid::Grid;
use crate::march::bricks::MaskedBricks;
use crate::march::marcher::{Marcher, clip_to_box};
use crate::picture::camera::tests::look_at;
use crate::picture::{Camera, Frame, RaymarchOptions, Shadows};
use crate::progress::Progress;
use crate::volume::sparse::SparseField;
use crate::volume::sparse::build::SparseOptions;
use crate::volume::{FieldView, Texel, Trilinear};
use glam::DVec3;
use half::f16;
use std::sync::Arc;
use std::sync::atomic::Ordering;

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

/// The pictures agree: hits except for one pixel in 10,000, depth to 1e-4 of the diagonal.
fn assert_same_picture(grid: &Grid, distances: &[f32], eye: DVec3, fov_deg: f64, shadows: Shadows) {
    let draw = |place: &Place, camera: &Camera, options: &RaymarchOptions| {
        raymarch_at(place, Source::Host(distances), grid, camera, options, &Progress::new()).unwrap()
    };
    assert_twins(grid, eye, fov_deg, shadows, draw);
}

/// [`assert_same_picture`] for the output of `draw` at a place; returns both pictures, the CPU's first.
fn assert_twins(
    grid: &Grid,
    eye: DVec3,
    fov_deg: f64,
    shadows: Shadows,
    draw: impl Fn(&Place, &Camera, &RaymarchOptions) -> Frame,
) -> Option<[Frame; 2]> {
    let context = test_context()?;
    let center = 0.5 * (grid.lower + grid.upper);
    let camera = Camera::from_pose(&look_at(eye, center), fov_deg).unwrap();
    let options = RaymarchOptions { size: [160, 128], shadows, ..RaymarchOptions::default() };
    let [cpu, gpu] = [Place::Cpu, Place::Gpu(context)].map(|place| draw(&place, &camera, &options));
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
    // Depths that differ by less than an ulp of the largest depth are equal in float32.
    let ulp = f64::from(f32::EPSILON) * (eye - center).length();
    assert!(worst <= tolerance + ulp, "depth differs by {worst:e}, allowed {tolerance:e}");
    // Rounding is visible at the edge of a shadow, and where the normal jumps between cells.
    assert!(shade <= pixels / 200, "{shade} pixels are shaded differently");
    Some([cpu, gpu])
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
fn a_solid_cut_by_the_box_shows_the_cut() {
    let (mut grid, distances) = blob([24, 24, 24], 0.0, DVec3::ZERO, 1.0);
    // The same samples in a smaller box represent a sphere that extends beyond it.
    let distances: Vec<f32> = distances.iter().map(|d| d - 0.5).collect();
    grid.upper *= 0.8;
    grid.lower *= 0.8;
    assert_same_picture(&grid, &distances, DVec3::new(1.5, 2.0, 3.0), 45.0, Shadows::Hard);
}

/// A dense field in some encoding, with a band of 4 voxels.
fn encoded<T: Texel>(grid: &Grid, distances: &[f32]) -> (Vec<T>, f32) {
    let scale = if T::ENCODING.is_normalised() { 4.0 * grid.spacing().max_element() as f32 } else { 1.0 };
    (distances.iter().map(|&distance| T::encode(distance, scale)).collect(), scale)
}

fn assert_same_encoded_picture<T: Texel>() {
    // 21 x 17 x 25 samples of one or two bytes do not fill whole words.
    for (shape, bumps) in [([21, 17, 25], 0.0), ([40, 24, 33], 0.15)] {
        let (grid, distances) = blob(shape, bumps, DVec3::ZERO, 1.0);
        let (texels, scale) = encoded::<T>(&grid, &distances);
        let field = FieldView::encoded(grid, &texels, scale).unwrap();
        let draw = |place: &Place, camera: &Camera, options: &RaymarchOptions| {
            raymarch_view(place, field, camera, options, &Progress::new()).unwrap()
        };
        assert_twins(&grid, DVec3::new(1.5, 2.0, 3.0), 45.0, Shadows::Hard, draw);
        assert_twins(&grid, DVec3::new(0.0, 0.2, 1.25), 80.0, Shadows::Hard, draw);
    }
}

#[test]
fn encoded_fields_are_drawn_alike() {
    assert_same_encoded_picture::<f16>();
    assert_same_encoded_picture::<i16>();
    assert_same_encoded_picture::<i8>();
}

fn sparse<T: Texel>(grid: &Grid, distances: &[f32], tolerance: Option<f64>) -> SparseField<T> {
    let options = SparseOptions { band: 3.0, tolerance };
    FieldView::new(*grid, distances).unwrap().to_sparse([grid.lower, grid.upper], &options, &Progress::new()).unwrap()
}

/// The pictures agree, and so does the number of steps of every ray that no tile shortens.
fn assert_same_sparse_picture<T: Texel>(field: &SparseField<T>, eye: DVec3, fov_deg: f64) {
    let view = field.view().unwrap();
    let marcher = Marcher::new(MaskedBricks::new(view, &Progress::new()).unwrap(), &Progress::new()).unwrap();
    let steps_of_whole_ray = |camera: &Camera, x: u32, y: u32, size: [u32; 2]| {
        let start = view.grid_from_world(camera.pixel_start(x, y, size));
        let direction = camera.pixel_direction(x, y, size) / view.grid().spacing();
        clip_to_box(start, direction, view.shape()).map_or(0, |clipped| marcher.march(&clipped.ray).steps)
    };
    let draw = |place: &Place, camera: &Camera, options: &RaymarchOptions| {
        let mut frame = raymarch_sparse(place, view, camera, options, &Progress::new()).unwrap();
        if matches!(place, Place::Cpu) {
            let width = options.size[0];
            frame.steps = (0..width * options.size[1])
                .map(|i| steps_of_whole_ray(camera, i % width, i / width, options.size))
                .collect();
        }
        frame
    };
    let Some([cpu, gpu]) = assert_twins(&field.grid, eye, fov_deg, Shadows::Hard, draw) else { return };
    // A ray through an edge of cells may visit either cell first, depending on rounding.
    let differ = cpu.steps.iter().zip(&gpu.steps).filter(|(a, b)| a != b).count();
    assert!(differ <= cpu.steps.len() / 100, "{differ} rays take other steps");
}

fn assert_same_sparse_pictures<T: Texel>() {
    let (grid, distances) = blob([60, 44, 51], 0.1, DVec3::ZERO, 1.0);
    // Cells of one voxel, and cells of up to four.
    for tolerance in [None, Some(0.3)] {
        let field = sparse::<T>(&grid, &distances, tolerance);
        let coarse: usize = field.view().unwrap().bricks_by_level()[1..].iter().sum();
        assert_eq!(coarse > 0, tolerance.is_some());
        assert_same_sparse_picture(&field, DVec3::new(1.5, 2.0, 3.0), 45.0);
        assert_same_sparse_picture(&field, DVec3::new(0.0, 0.2, 1.25), 80.0);
    }
}

#[test]
fn sparse_fields_are_drawn_alike_in_every_encoding() {
    assert_same_sparse_pictures::<f32>();
    assert_same_sparse_pictures::<f16>();
    assert_same_sparse_pictures::<i16>();
    assert_same_sparse_pictures::<i8>();
}

#[test]
fn sparse_fields_agree_where_the_box_cuts_them_and_far_from_the_origin() {
    let (mut grid, distances) = blob([60, 60, 60], 0.0, DVec3::ZERO, 1.0);
    // Whole bricks inside, some of them cut by the box.
    let grown: Vec<f32> = distances.iter().map(|d| d - 0.5).collect();
    grid.upper *= 0.8;
    grid.lower *= 0.8;
    let field = sparse::<f32>(&grid, &grown, None);
    assert!(field.index.contains(&crate::volume::sparse::Entry::Empty { inside: true }.to_word()));
    assert_same_sparse_picture(&field, DVec3::new(1.5, 2.0, 3.0), 45.0);
    // The eye in the solid.
    assert_same_sparse_picture(&field, DVec3::new(0.1, 0.0, 0.1), 45.0);

    let center = DVec3::new(1e5, -2e5, 3e4);
    let (grid, distances) = blob([48, 48, 48], 0.1, center, 1e-3);
    let field = sparse::<i16>(&grid, &distances, Some(0.1));
    assert_same_sparse_picture(&field, center + DVec3::new(1e-3, 2e-3, 3e-3), 45.0);
}

#[test]
fn a_device_is_sent_the_stored_bytes_and_little_else() {
    let Some(shared_context) = test_context() else { return };
    // A separate context, because other tests upload at the same time.
    let context = Arc::new(crate::gpu::Context::open(&shared_context.info).unwrap());
    let (grid, distances) = blob([96, 96, 96], 0.0, DVec3::ZERO, 1.0);
    let camera = Camera::from_pose(&look_at(DVec3::new(1.5, 2.0, 3.0), DVec3::ZERO), 45.0).unwrap();
    let options = RaymarchOptions { size: [32, 24], ..RaymarchOptions::default() };
    let place = Place::Gpu(context.clone());
    let uploaded = |draw: &dyn Fn() -> Frame| {
        let before = context.counters.uploaded_bytes.load(Ordering::Relaxed);
        assert!(draw().object_id.contains(&0));
        (context.counters.uploaded_bytes.load(Ordering::Relaxed) - before) as usize
    };
    // A light, the parameters of the picture at their allocation and before the kernel, and the parameters of the
    // samples.
    const BESIDE: usize =
        size_of::<layout::Light>() + 2 * size_of::<layout::MarchParams>() + size_of::<layout::StoredParams>();

    let (texels, scale) = encoded::<i8>(&grid, &distances);
    let field = FieldView::encoded(grid, &texels, scale).unwrap();
    let sent = uploaded(&|| raymarch_view(&place, field, &camera, &options, &Progress::new()).unwrap());
    assert!(sent <= grid.len() + BESIDE, "{sent} bytes for {}", grid.len());

    let field = sparse::<i8>(&grid, &distances, Some(0.05));
    let view = field.view().unwrap();
    let sent = uploaded(&|| raymarch_sparse(&place, view, &camera, &options, &Progress::new()).unwrap());
    // One byte per brick stores the leap.
    let parameters = BESIDE + size_of::<layout::SparseParams>();
    assert!(sent <= field.bytes() + field.index.len() + parameters, "{sent} bytes for {}", field.bytes());
    assert!(sent < grid.len());
}

#[test]
fn a_grid_with_too_many_voxels_on_the_way_is_refused() {
    let Some(context) = test_context() else { return };
    let grid = Grid::new(DVec3::ZERO, DVec3::new(16_400.0, 1.0, 1.0), [16_400, 1, 1]).unwrap();
    let distances: Vec<f32> = (0..grid.len()).map(|x| x as f32 - 8000.0).collect();
    let field = sparse::<i8>(&grid, &distances, None);
    let camera = Camera::from_pose(&look_at(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO), 45.0).unwrap();
    let options = RaymarchOptions { size: [8, 8], ..RaymarchOptions::default() };
    let view = field.view().unwrap();
    let told = raymarch_sparse(&Place::Gpu(context), view, &camera, &options, &Progress::new()).unwrap_err();
    assert!(told.to_string().contains("16384 voxels"), "{told}");
}

#[test]
fn a_device_decodes_every_stored_number_as_the_core_does() {
    let Some(context) = test_context() else { return };
    let text = [shared("decode").unwrap(), shared("samples_encoded").unwrap()].concat().replace("#import decode", "")
        + "@group(0) @binding(2) var<storage, read_write> decoded: array<f32>;
           @compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3u) {
               decoded[id.x] = stored_sample(id.x);
           }";
    let kernel = context.compile("decode", "main", &text).unwrap();
    for (number, encoding) in [(1, Encoding::Float16), (2, Encoding::Snorm16), (3, Encoding::Snorm8)] {
        let stored: Vec<u32> = (0..1u32 << (8 * encoding.bytes()))
            // Infinities and NaN are refused earlier.
            .map(|bits| if encoding == Encoding::Float16 && bits & 0x7c00 == 0x7c00 { 0 } else { bits })
            .collect();
        let bytes: Vec<u8> = stored.iter().flat_map(|bits| bits.to_le_bytes()[..encoding.bytes()].to_vec()).collect();
        let scale = 0.3;
        let params = layout::StoredParams { encoding: number, scale, ..Default::default() };
        let words = context.upload_bytes("stored", &bytes).unwrap();
        let uniform = context.uniform("encoding", &params).unwrap();
        let decoded = context.storage("decoded", 4 * stored.len() as u64).unwrap();
        let group = context.bind("decode", &kernel, &[(1, &words), (2, &decoded), (7, &uniform)]).unwrap();
        context.dispatch("decode", &kernel, &group, [stored.len() as u32 / 64, 1, 1]).unwrap();
        let mut values = vec![0.0f32; stored.len()];
        context.read("decoded", &decoded, &mut values, &Progress::new()).unwrap();
        for (bits, value) in stored.into_iter().zip(values) {
            let expected = encoding.decode(bits, scale);
            // Halves are decoded by shifts alone. The others have a quotient within 2.5 ulp (WGSL) and a product.
            let allowed = if encoding == Encoding::Float16 { 0.0 } else { 3.5 * f32::EPSILON * expected.abs() };
            assert!((value - expected).abs() <= allowed, "{encoding:?} {bits:x}: {value}, expected {expected}");
        }
    }
}
