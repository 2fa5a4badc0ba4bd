//! The mesh is closed and two-manifold for every field, and reproduces planes, edges and corners.

use super::*;
use mesh::on_box;
use std::collections::HashMap;
use std::f64::consts::PI;

impl LevelSurface {
    /// As [`Self::into_mesh`], but keeps the surface.
    fn mesh(&self, crossings: &[Crossing], extra: &ExtraPlanes, options: MeshOptions) -> SurfaceMesh {
        let (mut vertices, mut quads) = self.settled(crossings, extra, options);
        let progress = Progress::new();
        let division =
            self.untangle(&mut vertices.places, &mut quads, crossings, extra, options.sharp, &progress).unwrap();
        let is_open = if options.capped { Vec::new() } else { on_box(crossings) };
        self.divided_mesh(vertices, &quads, crossings, &division, &is_open, &mut Vec::new())
    }
}

const SHARP: MeshOptions = MeshOptions { sharp: true, capped: true };
const SMOOTH: MeshOptions = MeshOptions { sharp: false, capped: true };

fn fill(grid: &Grid, field: impl Fn(DVec3) -> f64) -> Vec<f32> {
    let [nx, ny, nz] = grid.shape;
    let mut values = Vec::with_capacity(grid.len());
    for z in 0..nz {
        for y in 0..ny {
            values.extend((0..nx).map(|x| field(grid.center(x, y, z)) as f32));
        }
    }
    values
}

fn mesh_of(grid: Grid, distances: &[f32], level: f32, options: MeshOptions) -> SurfaceMesh {
    let field = FieldView::new(grid, distances).unwrap();
    let surface = LevelSurface::of_field(&field, level, &Progress::new()).unwrap();
    surface.mesh(&surface.crossings(), &ExtraPlanes::default(), options)
}

fn signed_volume(mesh: &SurfaceMesh) -> f64 {
    let corner = |i: u32| mesh.vertices[i as usize] - mesh.vertices[0];
    mesh.faces.iter().map(|&[a, b, c]| corner(a).dot(corner(b).cross(corner(c))) / 6.0).sum()
}

/// Every directed edge is used once each way, every vertex has one fan of faces, and every face has an area.
fn assert_two_manifold(mesh: &SurfaceMesh) {
    let mut next: HashMap<(u32, u32), u32> = HashMap::new();
    let mut faces_at = vec![0; mesh.vertices.len()];
    for &[a, b, c] in &mesh.faces {
        for (from, to, third) in [(a, b, c), (b, c, a), (c, a, b)] {
            assert!(next.insert((from, to), third).is_none(), "the directed edge {from} {to} is used twice");
            faces_at[from as usize] += 1;
        }
        let [p, q, r] = [a, b, c].map(|i| mesh.vertices[i as usize]);
        assert!((q - p).cross(r - p).length() > 0.0);
    }
    assert!(next.keys().all(|&(from, to)| next.contains_key(&(to, from))), "an edge has no opposite");
    // Walking round a vertex from any of its faces comes back after all of them.
    let mut walked = vec![false; mesh.vertices.len()];
    for &[a, b, _] in &mesh.faces {
        if std::mem::replace(&mut walked[a as usize], true) {
            continue;
        }
        let (mut at, mut count) = (b, 0);
        loop {
            at = next[&(a, at)];
            count += 1;
            if at == b {
                break;
            }
        }
        assert_eq!(count, faces_at[a as usize], "vertex {a} has more than one fan");
    }
}

/// A small generator, so that fields are the same on every machine.
fn noise(seed: u64) -> impl FnMut() -> f32 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
    }
}

#[test]
fn random_fields_give_closed_two_manifolds() {
    for seed in 0..200 {
        let mut random = noise(seed);
        let shape = [2 + seed as usize % 7, 1 + seed as usize % 5, 3 + seed as usize % 6];
        let grid = Grid::new(DVec3::splat(-1.0), DVec3::new(1.0, 2.0, 0.5), shape).unwrap();
        let distances: Vec<f32> = (0..grid.len()).map(|_| random()).collect();
        for options in [SHARP, SMOOTH] {
            let mesh = mesh_of(grid, &distances, 0.1, options);
            assert_two_manifold(&mesh);
            let inside = |p: &DVec3| p.cmpge(grid.lower).all() && p.cmple(grid.upper).all();
            assert!(mesh.vertices.iter().all(inside));
        }
    }
}

#[test]
fn coarse_noise_with_zeros_and_equal_values_too() {
    for seed in 0..200 {
        let mut random = noise(seed + 1000);
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [6, 6, 6]).unwrap();
        let distances: Vec<f32> = (0..grid.len()).map(|_| (random() * 4.0).round()).collect();
        assert_two_manifold(&mesh_of(grid, &distances, 0.0, SHARP));
    }
}

#[test]
fn blocks_give_the_mesh_of_the_whole_grid() {
    let mut random = noise(7);
    let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [9, 6, 7]).unwrap();
    let distances: Vec<f32> = (0..grid.len()).map(|_| random()).collect();
    let side = 4;
    let (mut origins, mut values) = (Vec::new(), Vec::new());
    for z in (-1..7).step_by(side) {
        for y in (-1..6).step_by(side) {
            for x in (-1..9).step_by(side) {
                origins.push([x, y, z]);
                for k in z..=z + side as i32 {
                    for j in y..=y + side as i32 {
                        for i in x..=x + side as i32 {
                            let clamp = |i: i32, axis: usize| i.clamp(0, grid.shape[axis] as i32 - 1) as usize;
                            values.push(distances[grid.offset(clamp(i, 0), clamp(j, 1), clamp(k, 2))]);
                        }
                    }
                }
            }
        }
    }
    let mut blocks = SurfaceBlocks::new(grid, 0.05).unwrap();
    let half = origins.len() / 2;
    let (first, second) = values.split_at(half * (side + 1).pow(3));
    blocks.add(side, &origins[..half], first).unwrap();
    blocks.add(side, &origins[half..], second).unwrap();
    let surface = blocks.surface();
    let mesh = surface.mesh(&surface.crossings(), &ExtraPlanes::default(), SHARP);
    assert_eq!(mesh, mesh_of(grid, &distances, 0.05, SHARP));
}

#[test]
fn a_sphere_on_oblong_voxels_comes_back() {
    let grid = Grid::new(DVec3::new(99.0, -1.3, -1.2), DVec3::new(101.4, 1.3, 1.2), [24, 40, 30]).unwrap();
    let center = DVec3::new(100.2, 0.0, 0.0);
    let distances = fill(&grid, |p| (p - center).length() - 1.0);
    for options in [SHARP, SMOOTH] {
        let mesh = mesh_of(grid, &distances, 0.0, options);
        assert_two_manifold(&mesh);
        // The trilinear surface of a sphere of radius r lies h^2 / (8 r) inside it at most along each axis; the planes
        // at the crossings meet as far outside.
        let bound = grid.spacing().length_squared() / 4.0;
        assert!(mesh.vertices.iter().all(|&p| ((p - center).length() - 1.0).abs() <= bound));
        assert!((signed_volume(&mesh) / (4.0 / 3.0 * PI) - 1.0).abs() <= 0.02);
    }
}

#[test]
fn another_level_is_an_offset_surface() {
    let grid = Grid::new(DVec3::splat(-1.5), DVec3::splat(1.5), [30, 30, 30]).unwrap();
    let distances = fill(&grid, |p| p.length() - 1.0);
    let mesh = mesh_of(grid, &distances, -0.5, SHARP);
    assert_two_manifold(&mesh);
    assert!(mesh.vertices.iter().all(|p| (p.length() - 0.5).abs() <= grid.spacing().length_squared() / 2.0));
}

#[test]
fn a_surface_that_leaves_the_box_is_capped_on_its_face_or_open() {
    // The half space below z = 0.3 fills the box up to there; the cap has sharp edges.
    let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [8, 8, 8]).unwrap();
    let distances = fill(&grid, |p| p.z - 0.3);
    let mesh = mesh_of(grid, &distances, 0.0, SHARP);
    assert_two_manifold(&mesh);
    // Each vertex of an edge or corner is pulled by at most a thousandth of a voxel.
    assert!((signed_volume(&mesh) - 0.3).abs() <= 0.3 * 3.0 * 2e-3);
    let open = mesh_of(grid, &distances, 0.0, MeshOptions { capped: false, ..SHARP });
    // At the rim the pull towards the mean of the crossings moves a vertex by some thousandths of a voxel.
    assert!(open.vertices.iter().all(|p| (p.z - 0.3).abs() <= 5e-3 * grid.spacing().z));
    assert!(!open.faces.is_empty() && open.faces.len() < mesh.faces.len());
}

#[test]
fn no_surface_is_an_empty_mesh() {
    let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [2, 1, 1]).unwrap();
    let mesh = mesh_of(grid, &[1.0, 2.0], 0.0, SHARP);
    assert!(mesh.vertices.is_empty() && mesh.faces.is_empty());
    // A sample equal to the level is outside.
    assert!(mesh_of(grid, &[1.0, 2.0], 1.0, SHARP).faces.is_empty());
    assert!(!mesh_of(grid, &[1.0, 2.0], 2.0, SHARP).faces.is_empty());
    let field = FieldView::new(grid, &[1.0, 2.0]).unwrap();
    assert!(LevelSurface::of_field(&field, f32::NAN, &Progress::new()).is_err());
}

#[test]
fn a_turned_cube_keeps_its_faces_and_edges_with_its_mesh_as_source() {
    let turn = glam::DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    let corner = |i: usize| turn * (DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) * 2.0 - 1.0);
    let vertices: Vec<[f64; 3]> = (0..8).map(|i| corner(i).to_array()).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let faces: Vec<[i64; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let cube = crate::mesh::Mesh::new(&vertices, &faces).unwrap();
    let grid = Grid::new(DVec3::splat(-2.0), DVec3::splat(2.0), [32, 32, 32]).unwrap();
    let distances = fill(&grid, |p| {
        let q = (turn.inverse() * p).abs() - 1.0;
        q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
    });
    let field = FieldView::new(grid, &distances).unwrap();
    let surface = LevelSurface::of_field(&field, 0.0, &Progress::new()).unwrap();
    let mut crossings = surface.crossings();
    planes_of_mesh(&surface, &mut crossings, &cube, 0.0, false, &Progress::new()).unwrap();
    let mut extra = ExtraPlanes::default();
    for sharp_only in [false, true] {
        let probes = surface.probes(&crossings, &extra, sharp_only);
        let (points, normals): (Vec<_>, Vec<_>) = probes.points.iter().map(|&p| nearest_plane(&cube, p)).unzip();
        extra = surface.join_planes(&crossings, &extra, &probes, &points, &normals);
    }
    let mesh = surface.mesh(&crossings, &extra, SHARP);
    assert_two_manifold(&mesh);
    let voxel = grid.spacing().x;
    for i in 0..8 {
        let nearest = mesh.vertices.iter().map(|p| p.distance(corner(i))).fold(f64::INFINITY, f64::min);
        assert!(nearest <= 0.02 * voxel, "corner {i} is {} voxels off", nearest / voxel);
    }
    let off = |p: &DVec3| ((turn.inverse() * *p).abs().max_element() - 1.0).abs();
    assert!(mesh.vertices.iter().all(|p| off(p) <= 0.02 * voxel));
    assert!((signed_volume(&mesh) / 8.0 - 1.0).abs() <= 2e-3);
}

/// The nearest point of a mesh and the outward normal of its face.
fn nearest_plane(mesh: &crate::mesh::Mesh, p: DVec3) -> (DVec3, DVec3) {
    let closest = mesh.closest_point(mesh.local_from_world(p));
    let [a, b, c] = mesh.triangle(closest.face);
    (mesh.world_from_local(closest.on_triangle.point), (b - a).cross(c - a).normalize())
}

/// A level set of noise, with planes of a source through points on a lattice of half voxels around its vertices: many
/// vertices are pulled out of their cells, and to equal places.
fn pulled_noise(seed: u64) -> (LevelSurface, Vec<f32>, Vec<Crossing>, ExtraPlanes) {
    let mut random = noise(seed);
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(5.0), [5, 5, 5]).unwrap();
    let distances: Vec<f32> = (0..grid.len()).map(|_| random()).collect();
    let field = FieldView::new(grid, &distances).unwrap();
    let surface = LevelSurface::of_field(&field, 0.0, &Progress::new()).unwrap();
    let (crossings, none) = (surface.crossings(), ExtraPlanes::default());
    let probes = surface.probes(&crossings, &none, false);
    let points: Vec<DVec3> = probes.points.iter().map(|p| (2.0 * p).round() / 2.0).collect();
    let normals: Vec<DVec3> = points.iter().map(|_| DVec3::from_array([0; 3].map(|_| f64::from(random())))).collect();
    let extra = surface.join_planes(&crossings, &none, &probes, &points, &normals);
    (surface, distances, crossings, extra)
}

/// The winding number of a mesh, by the solid angles of its faces (van Oosterom and Strackee, 1983).
fn winding(mesh: &SurfaceMesh, p: DVec3) -> f64 {
    let angle = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|i| mesh.vertices[i as usize] - p);
        let [la, lb, lc] = [a, b, c].map(DVec3::length);
        let bottom = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * a.dot(b.cross(c)).atan2(bottom)
    };
    mesh.faces.iter().map(angle).sum::<f64>() / (4.0 * PI)
}

#[test]
fn vertices_outside_their_cells_keep_samples_on_their_sides_and_do_not_meet() {
    for seed in 0..300 {
        let (surface, distances, crossings, extra) = pulled_noise(seed);
        let mesh = surface.mesh(&crossings, &extra, SHARP);
        assert_two_manifold(&mesh);
        let mut places: Vec<[u32; 3]> =
            mesh.vertices.iter().map(|p| p.as_vec3().to_array().map(|x| (x + 0.0).to_bits())).collect();
        places.sort_unstable();
        assert!(places.windows(2).all(|pair| pair[0] != pair[1]), "seed {seed}: equal positions");
        for (i, &value) in distances.iter().enumerate() {
            let p = surface.world([i % 5, i / 5 % 5, i / 25].map(|i| i as i32), DVec3::ZERO);
            let is_inside = winding(&mesh, p).round() as i64 % 2 != 0;
            // A sample within the rounding of the level counts as outside.
            assert_eq!(is_inside, value < -1.0 / f32::from(1u16 << 14), "seed {seed}: sample {i}");
        }
    }
}

#[test]
fn a_vertex_counts_as_clamped_once() {
    for seed in 0..100 {
        let (surface, _, crossings, extra) = pulled_noise(seed);
        let mesh = surface.mesh(&crossings, &extra, SHARP);
        // The vertices that are not where the planes put them, up to a voxel outside their regions.
        let is_elsewhere = |id: u32, &place: &DVec3| {
            let cell = surface.cells.of_patch(id);
            let planes = surface.planes(cell, id, &crossings, extra.of(id));
            let (best, clamped) = surface.vertex(cell, &planes, SHARP, true);
            if !clamped {
                return place != best;
            }
            let [lower, upper] = surface.region(cell, cell.free);
            let best = planes.minimum(lower - surface.spacing, upper + surface.spacing).point;
            place != (surface.world(cell.index, DVec3::ZERO) + best).clamp(surface.lower, surface.upper)
        };
        // Vertices of divided quadrilaterals follow the vertices of the patches.
        let of_patches = &mesh.vertices[..surface.cells.patch_count()];
        let elsewhere = (0..).zip(of_patches).filter(|&(id, place)| is_elsewhere(id, place)).count();
        assert!(mesh.clamped <= elsewhere, "seed {seed}: {} clamped, {elsewhere} elsewhere", mesh.clamped);
    }
}

/// Number of pairs of faces that cross, by brute force.
fn crossing_pairs(mesh: &SurfaceMesh) -> usize {
    let triangles: Vec<[DVec3; 3]> = mesh.faces.iter().map(|face| face.map(|i| mesh.vertices[i as usize])).collect();
    let boxes: Vec<[DVec3; 2]> = triangles.iter().map(|[a, b, c]| [a.min(*b).min(*c), a.max(*b).max(*c)]).collect();
    let pairs = (0..triangles.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    pairs
        .filter(|&(i, j)| {
            let common = mesh.faces[i].iter().filter(|vertex| mesh.faces[j].contains(vertex)).count();
            boxes[i][0].cmple(boxes[j][1]).all()
                && boxes[j][0].cmple(boxes[i][1]).all()
                && common < 2
                && crate::geometry::triangles_cross(triangles[i], triangles[j])
        })
        .count()
}

#[test]
fn faces_do_not_cross_in_noise() {
    let mut random = crate::mesh::random::uniform(3);
    for case in 0..40 {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0), [6, 7, 5]).unwrap();
        let values: Vec<f32> = (0..grid.len()).map(|_| random() as f32 - 0.5).collect();
        for options in [SHARP, SMOOTH] {
            let mesh = mesh_of(grid, &values, 0.0, options);
            assert_two_manifold(&mesh);
            assert_eq!(crossing_pairs(&mesh), 0, "case {case}, {options:?}");
        }
    }
}

#[test]
fn faces_do_not_cross_in_thin_curved_walls() {
    // Walls of 1.2 voxels about a gyroid with a period of 7 voxels, with planes that meet outside the cells.
    let grid = Grid::new(DVec3::splat(-1.0), DVec3::splat(1.0), [18; 3]).unwrap();
    let frequency = 2.0 * PI / (7.0 * grid.spacing().x);
    let field = |p: DVec3| {
        let [x, y, z] = (p * frequency).to_array();
        let value = x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos();
        (value.abs() / (frequency * 3f64.sqrt()) - 0.6 * grid.spacing().x).max(p.length() - 0.9)
    };
    for options in [SHARP, SMOOTH] {
        let mesh = mesh_of(grid, &fill(&grid, field), 0.0, options);
        assert_two_manifold(&mesh);
        assert!(mesh.faces.len() > 1000);
        assert_eq!(crossing_pairs(&mesh), 0, "{options:?}");
    }
}

/// The mesh of spheres with exact planes. `centers` and `radius` are in voxels.
fn mesh_of_spheres(centers: Vec<DVec3>, radius: f64) -> SurfaceMesh {
    let sphere = move |p: DVec3| {
        let nearest = centers.iter().copied().min_by(|a, b| p.distance(*a).total_cmp(&p.distance(*b))).unwrap();
        (p.distance(nearest) - radius, (p - nearest).normalize_or_zero())
    };
    let grid = Grid::new(DVec3::ZERO, DVec3::splat(8.0), [8; 3]).unwrap();
    let distances = fill(&grid, |p| sphere(p).0);
    let surface = LevelSurface::of_field(&FieldView::new(grid, &distances).unwrap(), 0.0, &Progress::new()).unwrap();
    let mut crossings = surface.crossings();
    for (edge, crossing) in (0..).zip(&mut crossings) {
        let on_edge = surface.edge(edge).at(crossing.share);
        let (distance, normal) = sphere(on_edge);
        crossing.set_plane(on_edge, on_edge - normal * distance, normal);
    }
    let nearby = move |places: &[probes::Place], found: &mut dyn FnMut(usize, DVec3, DVec3)| {
        for (i, place) in places.iter().enumerate() {
            let (distance, normal) = sphere(place.point);
            found(i, place.point - normal * distance, normal);
        }
    };
    let extra = ExtraPlanes::default().with_nearby(Box::new(nearby), false);
    surface.into_mesh(crossings, extra, SHARP, &Progress::new()).unwrap()
}

#[test]
fn spheres_of_one_voxel_are_round() {
    let mut random = crate::mesh::random::uniform(5);
    for case in 0..50 {
        let center = DVec3::splat(3.5) + DVec3::from_array([0; 3].map(|_| random()));
        let radius = 1.0 + random();
        let mesh = mesh_of_spheres(vec![center], radius);
        assert_two_manifold(&mesh);
        for [a, b, c] in mesh.faces.iter().map(|face| face.map(|i| mesh.vertices[i as usize])) {
            for place in [a, 0.5 * (a + b), (a + b + c) / 3.0] {
                let error = (place.distance(center) - radius).abs();
                assert!(error <= 0.1, "case {case}, radius {radius}: {error}");
            }
        }
    }
}

#[test]
fn changes_do_not_let_close_spheres_cross() {
    let mut random = crate::mesh::random::uniform(6);
    for case in 0..50 {
        let [middle, away] = [0; 2].map(|_| DVec3::from_array([0; 3].map(|_| random() - 0.5)));
        let radius = 1.0 + random();
        // The gap is a third of a voxel or less.
        let away = away.normalize() * (radius + random() / 6.0);
        let mesh = mesh_of_spheres([away, -away].map(|away| 4.0 + middle + away).to_vec(), radius);
        assert_two_manifold(&mesh);
        assert_eq!(crossing_pairs(&mesh), 0, "case {case}");
    }
}
