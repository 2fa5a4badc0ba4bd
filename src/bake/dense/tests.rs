//! The dense bake against the single-point search, on shapes that are hard to cull.

use super::*;
use crate::bake::Samples;
use crate::grid::Grid;
use crate::mesh::Mesh;
use crate::mesh::random::soup;
use glam::DVec3;
use proptest::prelude::*;

/// Every sample of the grid against the closest point of the single-point search, whose own test is brute force.
fn assert_exact(mesh: &Mesh, lower: DVec3, upper: DVec3, shape: [usize; 3]) {
    let grid = Grid::new(lower, upper, shape).unwrap();
    let local = LocalGrid::new(&grid, mesh);
    let mut out = vec![f32::NAN; grid.len()];
    distances(mesh, &local, f32::INFINITY, 1.0, &Progress::new(), &mut out).unwrap();
    // The error bound of the module is 1e-6 of the box around mesh and grid. A tenth of it is typical.
    let reach = local.at([0; 3]).abs().max(local.at(shape.map(|n| n - 1)).abs()).max_element().max(1.0);
    for z in 0..shape[2] {
        for y in 0..shape[1] {
            for x in 0..shape[0] {
                let exact = mesh.closest_point(local.at([x, y, z])).distance;
                let found = f64::from(out[grid.offset(x, y, z)]);
                assert!((found - exact).abs() <= 1e-6 * reach, "{:?}: {found} is not {exact}", [x, y, z]);
            }
        }
    }
}

/// A sphere of latitude rings, whose triangles are all nearly equally far from the centre.
fn sphere(rings: usize, radius: f64) -> Mesh {
    let sectors = 2 * rings;
    let vertices: Vec<[f64; 3]> = (0..=rings)
        .flat_map(|ring| {
            let theta = std::f64::consts::PI * ring as f64 / rings as f64;
            (0..sectors).map(move |sector| {
                let phi = std::f64::consts::TAU * sector as f64 / sectors as f64;
                [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()].map(|x| radius * x)
            })
        })
        .collect();
    let at = |ring: usize, sector: usize| (ring * sectors + sector % sectors) as i64;
    let faces: Vec<[i64; 3]> = (0..rings)
        .flat_map(|ring| {
            (0..sectors).flat_map(move |sector| {
                let (a, b) = (at(ring, sector), at(ring, sector + 1));
                let (c, d) = (at(ring + 1, sector), at(ring + 1, sector + 1));
                [[a, c, d], [a, d, b]]
            })
        })
        .collect();
    Mesh::new(&vertices, &faces).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    /// Random triangle soups, from tiny triangles to some larger than the grid, on oblong grids of any size.
    #[test]
    fn soups_are_exact(
        count in 1usize..600, log_size in -3.0..1.0f64, seed in any::<u64>(),
        nx in 1usize..40, ny in 1usize..40, nz in 1usize..40, stretch in 0.3..3.0f64
    ) {
        let mesh = soup(count, 10f64.powf(log_size), seed);
        assert_exact(&mesh, DVec3::new(-0.6, -0.6 * stretch, -0.7), DVec3::new(0.6, 0.6, 0.7), [nx, ny, nz]);
    }
}

#[test]
fn a_sphere_seen_from_its_centre_is_exact() {
    let mesh = sphere(40, 1.0);
    assert_exact(&mesh, DVec3::splat(-1.1), DVec3::splat(1.1), [33; 3]);
    assert_exact(&mesh, DVec3::splat(-1e-3), DVec3::splat(1e-3), [9; 3]);
}

#[test]
fn voxels_much_larger_than_triangles_are_exact() {
    let mesh = sphere(100, 1.0);
    assert_exact(&mesh, DVec3::splat(-1.1), DVec3::splat(1.1), [7, 6, 5]);
    let (low, high) = (DVec3::new(0.5, -1.1, -1.1), DVec3::new(2.7, 1.1, 1.1));
    assert_exact(&mesh, low, high, [7, 6, 5]);

    // Beside the sphere a search measures few packs and the first block has many, so its samples are searched one by
    // one. Inside the sphere each search measures many packs, so the block has a list.
    assert!(packs_and_most(&mesh, low, high, [7, 6, 5]).is_gt());
    assert!(packs_and_most(&mesh, DVec3::splat(-0.1), DVec3::splat(0.1), [7, 6, 5]).is_lt());
}

/// Compares the number of packs of the first block of a grid with the most that a list holds.
fn packs_and_most(mesh: &Mesh, lower: DVec3, upper: DVec3, shape: [usize; 3]) -> std::cmp::Ordering {
    let local = LocalGrid::new(&Grid::new(lower, upper, shape).unwrap(), mesh);
    let bvh = mesh.bvh();
    let samples = [f32::INFINITY; TASK * TASK * TASK];
    let tile = Tile { bvh, grid: &local, slack: SLACK, limit: f32::INFINITY, leaves: u64::MAX, low: [0; 3], samples };
    let searched = bvh.nearest(SampleBox::new(&local, [0; 3], shape).center, f32::INFINITY).unwrap().packs;
    let block = SampleBox::new(&local, [0; 3], [LEAF; 3]);
    let near = bvh.nearest(block.center, f32::INFINITY).unwrap().slot;
    let (mut stack, mut packs) = (vec![(0, u8::MAX)], Vec::new());
    tile.list_packs(&block, near, usize::MAX, &mut stack, &mut packs);
    packs.len().cmp(&most_packs(LEAF * LEAF * LEAF, searched))
}

/// A list costs 26 for each pack; a search costs 8, and 3 for each pack that it measures.
#[test]
fn a_list_holds_as_many_packs_as_searches_would_cost() {
    assert_eq!(most_packs(64, 6), 64);
    assert_eq!(most_packs(64, 1), 27);
    assert_eq!(most_packs(8, 6), 8);
    assert_eq!(most_packs(1, 1), 0);
    assert_eq!(most_packs(64, 1 << 20), 64 * (8 + (3 << 20)) / 26);
}

#[test]
fn a_needle_fan_is_exact() {
    // Hundreds of slivers with a common tip: every box overlaps every other near it.
    let n = 300;
    let tip = [[0.0, 0.0, 0.0]];
    let rim = (0..=n).map(|i| {
        let angle = 0.3 * f64::from(i) / f64::from(n);
        [angle.cos(), angle.sin(), 0.02 * (9.0 * angle).sin()]
    });
    let vertices: Vec<[f64; 3]> = tip.into_iter().chain(rim).collect();
    let faces: Vec<[i64; 3]> = (1..=i64::from(n)).map(|i| [0, i, i + 1]).collect();
    assert_exact(&Mesh::new(&vertices, &faces).unwrap(), DVec3::splat(-0.2), DVec3::splat(1.1), [31, 29, 30]);
}

#[test]
fn doubled_faces_and_extreme_sizes_are_exact() {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for size in [1.0, 1.0, 1e-6] {
        let first = vertices.len() as i64;
        vertices.extend([[0.1, 0.2, 0.3], [0.1 + size, 0.2, 0.3], [0.1, 0.2 + size, 0.3 + 0.5 * size]]);
        faces.push([first, first + 1, first + 2]);
    }
    assert_exact(&Mesh::new(&vertices, &faces).unwrap(), DVec3::splat(-0.5), DVec3::splat(1.5), [20; 3]);
}

#[test]
fn far_and_tiny_grids_are_exact() {
    let mesh = soup(500, 0.1, 3);
    assert_exact(&mesh, DVec3::splat(50.0), DVec3::splat(51.0), [17; 3]);
    assert_exact(&mesh, DVec3::splat(0.1), DVec3::splat(0.1 + 1e-5), [12; 3]);
    // Inside one triangle, far from its edges.
    let one = Mesh::new(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [0.0, 1.0, 0.2]], &[[0, 1, 2]]).unwrap();
    assert_exact(&one, DVec3::splat(0.2), DVec3::splat(0.3), [16; 3]);
    assert_exact(&one, DVec3::splat(-1.0), DVec3::splat(1.0), [1; 3]);
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let mesh = soup(800, 0.2, 11);
    let grid = Grid::new(DVec3::splat(-0.6), DVec3::splat(0.6), [TASK; 3]).unwrap();
    let local = LocalGrid::new(&grid, &mesh);
    let portable =
        tile(mesh.bvh(), &local, |tile, scratch| tile.fill_portable(scratch, [0; 3], [TASK; 3])).map(f32::to_bits);
    assert_eq!(
        portable,
        tile(mesh.bvh(), &local, |tile, scratch| tile.fill(scratch, [0; 3], [TASK; 3])).map(f32::to_bits)
    );
}

/// Builds that carried a `TriangleFrame` from block to block failed this on every soup of two triangles or more: LLVM's
/// register coalescer compiled them wrongly. `scripts/check_units.sh` runs it for several numbers of codegen
/// units.
#[test]
fn no_triangle_is_dropped_in_this_build() {
    let soup = Soup::new();
    soup.assert_exact(&tile(&soup.bvh, &soup.grid, |tile, scratch| tile.fill(scratch, [0; 3], [TASK; 3])));
    soup.assert_exact(&tile(&soup.bvh, &soup.grid, |tile, scratch| tile.fill_portable(scratch, [0; 3], [TASK; 3])));
}

#[test]
#[should_panic(expected = "sample 1234")]
fn the_check_of_a_build_sees_a_damaged_sample() {
    let soup = Soup::new();
    let mut samples = tile(&soup.bvh, &soup.grid, |tile, scratch| tile.fill_portable(scratch, [0; 3], [TASK; 3]));
    samples[1234] += 1e-4;
    soup.assert_exact(&samples);
}

/// One tile of a grid, computed by `fill`.
fn tile(bvh: &Bvh, grid: &LocalGrid, fill: impl FnOnce(&mut Tile<'_>, &mut BlockScratch)) -> [f32; TASK * TASK * TASK] {
    let samples = [f32::INFINITY; TASK * TASK * TASK];
    let mut tile = Tile { bvh, grid, slack: SLACK, limit: f32::INFINITY, leaves: u64::MAX, low: [0; 3], samples };
    fill(&mut tile, &mut BlockScratch::default());
    tile.samples
}

/// 48 triangles of side 0.3 in the unit cube, and a grid of 16^3 samples around them.
struct Soup {
    bvh: Bvh,
    frames: Vec<TriangleFrame>,
    grid: LocalGrid,
}

impl Soup {
    fn new() -> Self {
        let mesh = soup(48, 0.3, 1);
        let frames = (0..48).map(|face| TriangleFrame::new(mesh.triangle(face))).collect();
        let step = 1.2 / (TASK - 1) as f64;
        let grid = LocalGrid { axes: [Samples { first: -0.6, step, start: 0, count: TASK }; 3] };
        Self { bvh: Bvh::build(mesh.positions(), mesh.faces()), frames, grid }
    }

    /// Every sample is, to the bit, the least of its distances to all triangles.
    fn assert_exact(&self, samples: &[f32; TASK * TASK * TASK]) {
        for (i, found) in samples.iter().enumerate() {
            let p = self.grid.at([i % TASK, i / TASK % TASK, i / (TASK * TASK)]).as_vec3();
            let least = self.frames.iter().map(|frame| frame.distance_squared(p)).fold(f32::INFINITY, f32::min);
            assert_eq!(least.sqrt().to_bits(), found.to_bits(), "sample {i}: {found} is not {}", least.sqrt());
        }
    }
}

#[test]
fn cancelling_stops_the_work() {
    let mesh = soup(100, 0.2, 5);
    let grid = Grid::new(DVec3::splat(-0.6), DVec3::splat(0.6), [40; 3]).unwrap();
    let progress = Progress::new();
    progress.cancel();
    let result = distances(&mesh, &LocalGrid::new(&grid, &mesh), f32::INFINITY, 1.0, &progress, &mut [0.0; 64000]);
    assert_eq!(result, Err(Error::Cancelled));
}
