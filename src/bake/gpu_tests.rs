//! The bake on a device against the bake on the CPU.

use super::*;
use crate::gpu::tests::test_context;
use std::f64::consts::TAU;

/// A surface of `around` by `along` quads, closed in `around`; `at` maps two parameters from 0 to 1 to a point.
fn tube(around: usize, along: usize, closed: bool, at: impl Fn(f64, f64) -> DVec3) -> Mesh {
    let rows = if closed { along } else { along + 1 };
    let vertices: Vec<[f64; 3]> = (0..rows * around)
        .map(|i| at((i % around) as f64 / around as f64, (i / around) as f64 / along as f64).to_array())
        .collect();
    let index = |u: usize, v: usize| (u % around + v % rows * around) as i64;
    let faces: Vec<[i64; 3]> = (0..around * along)
        .flat_map(|i| {
            let (u, v) = (i % around, i / around);
            let [a, b, c, d] = [index(u, v), index(u + 1, v), index(u + 1, v + 1), index(u, v + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    Mesh::new(&vertices, &faces).unwrap()
}

fn sphere(around: usize, along: usize) -> Mesh {
    tube(around, along, false, |u, v| {
        let (sin, cos) = (v * TAU / 2.0).sin_cos();
        DVec3::new(sin * (u * TAU).cos(), sin * (u * TAU).sin(), -cos)
    })
}

/// A trefoil tube with ripples, far from the origin.
fn knot(around: usize, along: usize) -> Mesh {
    tube(around, along, true, |u, v| {
        let (t, a) = (v * TAU, u * TAU);
        let center = DVec3::new(t.sin() + 2.0 * (2.0 * t).sin(), t.cos() - 2.0 * (2.0 * t).cos(), -(3.0 * t).sin());
        let radius = 0.4 + 0.05 * (7.0 * a + 11.0 * t).sin();
        let out = DVec3::new(center.x, center.y, 0.0).normalize();
        DVec3::new(1e4, -3e3, 7.0) + center + radius * (a.cos() * out + a.sin() * DVec3::Z)
    })
}

/// A box around a mesh.
fn grid_around(mesh: &Mesh, shape: [usize; 3]) -> Grid {
    let [lower, upper] = mesh.bounds();
    let margin = 0.1 * (upper - lower).max_element();
    Grid::new(lower - margin, upper + margin, shape).unwrap()
}

/// Both bakes agree: distances to 1e-6 of the diagonal, signs where the distance exceeds that.
fn assert_twins(mesh: &Mesh, grid: &Grid, options: &BakeOptions, slab_bytes: u64) -> Report {
    let Some(context) = test_context() else { return Report::default() };
    let cpu = bake(mesh, grid, options, &Progress::new()).unwrap();
    let (field, report) = gpu::bake(&context, mesh, grid, options, slab_bytes, &Progress::new()).unwrap();
    let device = field.read(&Progress::new()).unwrap();
    let tolerance = 1e-6 * grid.diagonal();
    let worst = cpu.distances.iter().zip(&device).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    assert!(worst <= tolerance, "{worst:e} exceeds {tolerance:e}");
    assert_eq!(report.sign_method, cpu.report.sign_method);
    if options.thickness.is_none() {
        assert_eq!(
            (report.inside_voxels, report.undecided_voxels),
            (cpu.report.inside_voxels, cpu.report.undecided_voxels)
        );
        assert!(cpu.distances.iter().zip(&device).all(|(a, b)| a.is_sign_negative() == b.is_sign_negative()));
    }
    report
}

#[test]
fn a_sphere_and_a_knot_agree_with_the_cpu() {
    for shape in [[20, 20, 20], [1, 1, 1], [33, 5, 18], [2, 40, 1]] {
        for mesh in [sphere(24, 16), knot(24, 160)] {
            assert_twins(&mesh, &grid_around(&mesh, shape), &BakeOptions::default(), u64::MAX);
        }
    }
}

#[test]
fn every_sign_rule_band_and_thickness_agree_with_the_cpu() {
    let mesh = knot(16, 90);
    let grid = grid_around(&mesh, [21, 26, 17]);
    for (_, sign) in SignMethod::NAMES {
        assert_twins(&mesh, &grid, &BakeOptions { sign, ..BakeOptions::default() }, u64::MAX);
    }
    for band in [0.5, 2.0, 9.0] {
        assert_twins(&mesh, &grid, &BakeOptions { band: Some(band), ..BakeOptions::default() }, u64::MAX);
    }
    assert_twins(&mesh, &grid, &BakeOptions { thickness: Some(0.3), ..BakeOptions::default() }, u64::MAX);
}

#[test]
fn an_open_mesh_agrees_with_the_cpu() {
    let bowl = tube(20, 6, false, |u, v| {
        let (sin, cos) = ((0.02 + 0.48 * v) * TAU / 2.0).sin_cos();
        DVec3::new(sin * (u * TAU).cos(), sin * (u * TAU).sin(), -cos)
    });
    assert_twins(&bowl, &grid_around(&bowl, [18, 18, 12]), &BakeOptions::default(), u64::MAX);
}

#[test]
fn a_field_in_slabs_is_the_same_field() {
    let Some(context) = test_context() else { return };
    let mesh = knot(16, 90);
    let grid = grid_around(&mesh, [19, 23, 29]);
    let options = BakeOptions { band: Some(3.0), ..BakeOptions::default() };
    let plane = 4 * 19 * 23;
    let read = |slab_bytes| {
        let (field, _) = gpu::bake(&context, &mesh, &grid, &options, slab_bytes, &Progress::new()).unwrap();
        (field.slabs().len(), field.read(&Progress::new()).unwrap())
    };
    let (_, whole) = read(u64::MAX);
    for (planes, slabs) in [(1, 29), (3, 10), (9, 4)] {
        assert_eq!(read(planes * plane), (slabs, whole.clone()));
    }
    assert_twins(&mesh, &grid, &options, 5 * plane);
}

#[test]
fn more_faces_than_a_software_adapter_loops_over() {
    let mesh = knot(60, 640);
    assert!(mesh.faces().len() > 70_000);
    assert_twins(&mesh, &grid_around(&mesh, [16, 16, 16]), &BakeOptions::default(), u64::MAX);
}

/// The centre of a sphere is equally near to every face, so its search visits the whole tree and runs out of rounds.
#[test]
fn a_search_that_runs_out_of_rounds_is_redone() {
    let mesh = sphere(400, 200);
    let grid = Grid::new(DVec3::splat(-1.1), DVec3::splat(1.1), [5, 5, 5]).unwrap();
    let report = assert_twins(&mesh, &grid, &BakeOptions::default(), u64::MAX);
    if test_context().is_some() {
        assert!(report.warnings.iter().any(|warning| warning.contains("measured on the CPU")), "{:?}", report.warnings);
    }
}

#[test]
fn a_cancelled_bake_stops_and_the_next_one_works() {
    let Some(context) = test_context() else { return };
    let mesh = knot(24, 160);
    let grid = grid_around(&mesh, [64, 64, 64]);
    let progress = Progress::new();
    let outcome = std::thread::scope(|scope| {
        let job =
            scope.spawn(|| bake_on_device(&context, &mesh, &grid, &BakeOptions::default(), &progress).map(|_| ()));
        std::thread::sleep(std::time::Duration::from_millis(60));
        progress.cancel();
        job.join().unwrap()
    });
    assert_eq!(outcome, Err(Error::Cancelled));
    assert_twins(&mesh, &grid_around(&mesh, [8, 8, 8]), &BakeOptions::default(), u64::MAX);
}

/// A software adapter runs at most 65,535 rounds. The last triangles of the knot lie beyond that.
#[test]
fn brute_force_agrees_past_the_loop_limit() {
    let Some(context) = test_context() else { return };
    for (mesh, shape) in [(knot(60, 640), [6, 5, 4]), (knot(16, 90), [17, 12, 15])] {
        let grid = grid_around(&mesh, shape);
        for sign in [SignMethod::Unsigned, SignMethod::Normal, SignMethod::Parity] {
            let brute = bake_brute(&context, &mesh, &grid, sign, &Progress::new()).unwrap();
            let exact = bake(&mesh, &grid, &BakeOptions { sign, ..BakeOptions::default() }, &Progress::new()).unwrap();
            let tolerance = 1e-6 * grid.diagonal();
            let pairs = || brute.distances.iter().zip(&exact.distances);
            let worst = pairs().map(|(a, b)| f64::from((a.abs() - b.abs()).abs())).fold(0.0, f64::max);
            assert!(worst <= tolerance, "{worst:e} exceeds {tolerance:e}");
            // The signs are float32: a grazing ray, or a tie of two nudged faces, may give either sign.
            let wrong = pairs().filter(|(a, b)| a.is_sign_negative() != b.is_sign_negative()).count();
            assert!(wrong <= grid.len() / 200, "{sign:?}: {wrong} signs differ");
        }
    }
}
