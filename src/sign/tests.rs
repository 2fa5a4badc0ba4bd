//! Every exact rule against brute-force winding numbers, on meshes and points chosen to produce ties.

use super::crossing::{Axes, ClosedSurface, Samples, scan_row};
use super::openings::SampleBlock;
use super::*;
use crate::geometry::solid_angle;
use crate::mesh::random::uniform;
use crate::progress::Progress;
use proptest::prelude::*;
use std::f64::consts::PI;

/// Winding number by definition: the sum of all solid angles.
fn brute_force(mesh: &Mesh, p: DVec3) -> f64 {
    let oriented = (0..mesh.faces().len() as u32).filter_map(|f| mesh.topology().oriented_face(mesh, f));
    let corner = |v: u32| mesh.exact_position(v) - p;
    oriented.map(|face| solid_angle(face.map(corner))).sum::<f64>() / (4.0 * PI)
}

fn mesh(vertices: &[[f64; 3]], faces: &[[i64; 3]]) -> Mesh {
    Mesh::new(vertices, faces).unwrap()
}

/// A box of integer corners, twelve outward faces.
fn add_box(vertices: &mut Vec<[f64; 3]>, faces: &mut Vec<[i64; 3]>, low: [f64; 3], high: [f64; 3]) {
    let first = vertices.len() as i64;
    vertices.extend((0..8).map(|i| [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { high[axis] } else { low[axis] })));
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    faces.extend(quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).map(|face| face.map(|v| v + first)));
}

/// Two boxes that overlap, and a cavity in the first.
fn boxes() -> Mesh {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    add_box(&mut vertices, &mut faces, [0.0; 3], [4.0; 3]);
    add_box(&mut vertices, &mut faces, [2.0, 2.0, 3.0], [6.0, 6.0, 7.0]);
    let before = faces.len();
    add_box(&mut vertices, &mut faces, [1.0; 3], [2.0; 3]);
    faces[before..].iter_mut().for_each(|face| face.swap(0, 1));
    mesh(&vertices, &faces)
}

/// A bumpy closed surface: a subdivided octahedron with radii from a small generator.
fn bumpy_sphere(seed: u64) -> (Vec<[f64; 3]>, Vec<[i64; 3]>) {
    let (rings, sectors) = (12usize, 17usize);
    let mut uniform = uniform(seed);
    let mut next = || 0.6 + 0.8 * uniform();
    let mut vertices = vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    for ring in 1..rings {
        let theta = PI * ring as f64 / rings as f64;
        for sector in 0..sectors {
            let phi = 2.0 * PI * sector as f64 / sectors as f64;
            let r = next();
            vertices.push([r * theta.sin() * phi.cos(), r * theta.sin() * phi.sin(), r * theta.cos()]);
        }
    }
    let at = |ring: usize, sector: usize| (2 + (ring - 1) * sectors + sector % sectors) as i64;
    let mut faces = Vec::new();
    for sector in 0..sectors {
        faces.push([0, at(1, sector), at(1, sector + 1)]);
        faces.push([1, at(rings - 1, sector + 1), at(rings - 1, sector)]);
        for ring in 1..rings - 1 {
            faces.push([at(ring, sector), at(ring + 1, sector), at(ring + 1, sector + 1)]);
            faces.push([at(ring, sector), at(ring + 1, sector + 1), at(ring, sector + 1)]);
        }
    }
    (vertices, faces)
}

/// Points whose rays run along faces and edges and through corners: every half integer around the boxes.
#[test]
fn counted_crossings_survive_every_tie() {
    let mesh = boxes();
    let surface = ClosedSurface::new(&mesh, &[]);
    for axes in [Axes::X, Axes::Y, Axes::Z] {
        for x in -1..=13 {
            for y in -1..=13 {
                for z in -1..=15 {
                    let world = DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * 0.5;
                    let p = mesh.local_from_world(world);
                    if mesh.closest_point(p).distance > 1e-9 {
                        assert_eq!(surface.winding(p, axes), brute_force(&mesh, p).round() as i32, "{world} {axes:?}");
                    }
                }
            }
        }
    }
}

/// The grid scan and the single ray are the same function, sample by sample, on a grid aligned with the faces.
#[test]
fn a_scanned_row_equals_single_rays() {
    let mesh = boxes();
    let surface = ClosedSurface::new(&mesh, &[]);
    // Steps of half a unit in local coordinates, from a corner of the first box.
    let step = 0.5 / mesh.scale();
    let first = mesh.local_from_world(DVec3::splat(-1.0));
    let samples = |axis: usize| Samples { first: first[axis], step, start: 0, count: 18 };
    for axes in [Axes::X, Axes::Y, Axes::Z, Axes { ray: 1, column: 0, row: 2 }] {
        let (columns, along, rows) = (samples(axes.column), samples(axes.ray), samples(axes.row));
        let mut windings = vec![0i16; columns.count * along.count];
        for row in 0..rows.count {
            scan_row(&surface, axes, rows.at(row), &columns, &along, &mut windings);
            for column in 0..columns.count {
                for i in 0..along.count {
                    let mut p = DVec3::ZERO;
                    p[axes.row] = rows.at(row);
                    p[axes.column] = columns.at(column);
                    p[axes.ray] = along.at(i);
                    let expected = surface.winding(p, axes);
                    assert_eq!(i32::from(windings[column * along.count + i]), expected, "{p} {axes:?}");
                }
            }
        }
    }
}

/// One ray beside the openings gives the winding number, or None: through an opening, or through the diagonals of
/// faces, which many of these rays meet.
#[test]
fn a_ray_beside_an_opening_gives_the_winding_number() {
    let closed = boxes();
    let vertices = closed.world_positions();
    let (mut decided, mut points) = (0, 0);
    for missing in 0..closed.faces().len() {
        let mut faces: Vec<_> = closed.faces().iter().map(|face| face.map(i64::from)).collect();
        faces.remove(missing);
        let mesh = mesh(vertices, &faces);
        let openings = Openings::of(&mesh);
        for i in 0..15 * 15 * 15 {
            let place = [i % 15, i / 15 % 15, i / 225].map(|i| 0.5 * f64::from(i) - 0.25);
            let p = mesh.local_from_world(DVec3::from_array(place));
            points += 1;
            let Some(winding) = openings.winding_by_ray(&mesh, p) else { continue };
            decided += 1;
            let found = f64::from(winding) - openings.fraction(p);
            assert!((found - brute_force(&mesh, p)).abs() <= 1e-9, "{place:?} without face {missing}: {found}");
        }
    }
    assert!(2 * decided > points, "{decided} of {points}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// A closed surface, and the same surface with any faces missing: counted crossings minus the angle of the cones
    /// equal the generalised winding number.
    #[test]
    fn closing_cones_give_the_winding_number_of_an_open_mesh(
        seed in any::<u64>(), missing in proptest::collection::vec(0usize..340, 0..12),
        points in proptest::collection::vec((-1.3..1.3f64, -1.3..1.3f64, -1.3..1.3f64), 50)
    ) {
        let (vertices, mut faces) = bumpy_sphere(seed);
        for f in missing {
            faces.swap_remove(f % faces.len());
        }
        let mesh = mesh(&vertices, &faces);
        let openings = Openings::of(&mesh);
        let surface = ClosedSurface::new(&mesh, &openings.caps);
        for (x, y, z) in points {
            let p = mesh.local_from_world(DVec3::new(x, y, z));
            let found = f64::from(surface.winding(p, Axes::X)) - openings.fraction(p);
            let expected = brute_force(&mesh, p);
            prop_assert!((found - expected).abs() < 1e-9);
            if let Some(winding) = openings.winding_by_ray(&mesh, p) {
                prop_assert!((f64::from(winding) - openings.fraction(p) - expected).abs() < 1e-9);
            }
        }
    }

    /// The value that decides a block equals the value of every sample in it.
    #[test]
    fn block_decisions_hold_for_every_sample(seed in any::<u64>(), missing in 1usize..40) {
        let (vertices, mut faces) = bumpy_sphere(seed);
        faces.drain(..missing);
        let mesh = mesh(&vertices, &faces);
        let openings = Openings::of(&mesh);
        let at = |voxel: [usize; 3]| DVec3::from_array(voxel.map(|i| -1.2 + i as f64 * 0.11));
        let mut seen = 0;
        let block = SampleBlock { low: [0; 3], high: [23, 22, 21], at: &at };
        openings.for_each_rounded_fraction(&block, &Progress::new(), &mut |voxel, rounded| {
            seen += 1;
            assert_eq!(rounded, openings.fraction(at(voxel)).round() as i32);
            assert_eq!(rounded, openings.rounded_ball(at(voxel)).0);
        }).unwrap();
        prop_assert_eq!(seen, 23 * 22 * 21);
    }

    /// The same for openings with long rims, whose closing triangles have several levels: blocks of the size of voxels
    /// and larger, near the rim and inside it.
    #[test]
    fn block_decisions_hold_within_long_rims(seed in any::<u64>(), bend in 0.0..0.3f64, step in 0.01..0.1f64) {
        let mesh = fan(1000, bend);
        let openings = Openings::of(&mesh);
        prop_assert!(openings.caps.len() <= 1300);
        let mut next = uniform(seed);
        let corner = DVec3::new(next() - 0.6, next() - 0.6, 0.3 * (next() - 0.6));
        let at = |voxel: [usize; 3]| corner + DVec3::from_array(voxel.map(|i| i as f64 * step));
        let block = SampleBlock { low: [0; 3], high: [9, 8, 7], at: &at };
        let rule = SignRule::Counted(Openings::of(&mesh));
        openings.for_each_rounded_fraction(&block, &Progress::new(), &mut |voxel, rounded| {
            let p = at(voxel);
            assert_eq!(rounded, openings.fraction(p).round() as i32);
            assert_eq!(rounded, openings.rounded_ball(p).0);
            let winding = brute_force(&mesh, p).abs();
            assert!(rule.is_inside_without_distance(&mesh, p) == (winding > 0.5) || (winding - 0.5).abs() < 1e-9);
        }).unwrap();
        // Neither the slope nor the clearance of a ball is too small: points of the ball have its integer.
        for _ in 0..20 {
            let p = DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5);
            let (rounded, radius) = openings.rounded_ball(p);
            let direction = DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5).normalize();
            let q = p + direction * radius.min(3.0) * 0.999;
            assert_eq!(rounded, openings.fraction(q).round() as i32, "{p} {q}");
        }
    }

    /// Points that follow each other have the sides of single points, among scattered openings.
    #[test]
    fn a_walk_has_the_sides_of_its_points(seed in any::<u64>(), every in 6usize..40) {
        let (vertices, mut faces) = bumpy_sphere(seed);
        let mut index = 0;
        faces.retain(|_| {
            index += 1;
            index % every != 0
        });
        let mesh = mesh(&vertices, &faces);
        let rule = SignRule::Counted(Openings::of(&mesh));
        let mut walk = SideWalk::default();
        let mut next = uniform(seed);
        let mut p = DVec3::new(0.1, 0.0, 0.0);
        for _ in 0..400 {
            let step = DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5) * 0.2;
            p = (p + step).clamp(DVec3::splat(-1.4), DVec3::splat(1.4));
            let local = mesh.local_from_world(p);
            let inside = walk.is_inside(&rule, &mesh, local, &mesh.closest_point(local));
            let winding = brute_force(&mesh, local).abs();
            prop_assert!(inside == (winding > 0.5) || (winding - 0.5).abs() < 1e-9, "{p} {winding}");
        }
    }

    /// The fast winding number stays within the error that its module states.
    #[test]
    fn fast_winding_numbers_are_good_to_a_hundredth(
        seed in any::<u64>(), missing in 0usize..200, x in -1.5..1.5f64, y in -1.5..1.5f64, z in -1.5..1.5f64
    ) {
        let (vertices, mut faces) = bumpy_sphere(seed);
        faces.drain(..missing);
        let mesh = mesh(&vertices, &faces);
        let p = mesh.local_from_world(DVec3::new(x, y, z));
        let error = (mesh.moments().winding(&mesh, p) - brute_force(&mesh, p)).abs();
        prop_assert!(error < 0.01, "{error}");
    }

    /// The same bound for slivers, which are cut into pieces.
    #[test]
    fn winding_numbers_of_slivers_are_good_to_a_hundredth(
        seed in any::<u64>(), width in prop::sample::select(vec![1e-4, 1e-3, 0.03])
    ) {
        let mut next = uniform(seed);
        let mesh = slivers(1500, width, &mut next);
        prop_assert!(mesh.moments().has_pieces());
        for _ in 0..40 {
            let p = DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5);
            let error = (mesh.moments().winding(&mesh, p) - brute_force(&mesh, p)).abs();
            prop_assert!(error < 0.01, "{p} {error}");
        }
    }

    /// On a clean mesh every rule gives the same answer.
    #[test]
    fn all_rules_agree_on_a_clean_mesh(seed in any::<u64>(), x in -1.3..1.3f64, y in -1.3..1.3f64, z in -1.3..1.3f64) {
        let (vertices, faces) = bumpy_sphere(seed);
        let mesh = mesh(&vertices, &faces);
        let p = mesh.local_from_world(DVec3::new(x, y, z));
        let closest = mesh.closest_point(p);
        // The nudge of the `normal` rule is 1e-4, so the rule is not accurate at smaller distances.
        prop_assume!(closest.distance > 1e-3);
        let inside = brute_force(&mesh, p) > 0.5;
        let counted = SignRule::Counted(Openings::default());
        for rule in [counted, SignRule::Winding, SignRule::Parity, SignRule::Pseudonormal] {
            prop_assert_eq!(rule.is_inside(&mesh, p, &closest), inside, "{:?}", rule);
        }
    }
}

/// Slivers of length 1 with random directions, some of which repeat others.
pub(super) fn slivers(count: usize, width: f64, next: &mut impl FnMut() -> f64) -> Mesh {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    let mut vector = || [0; 3].map(|_| 2.0 * next() - 1.0);
    for i in 0..count {
        let (center, along, beside) = (vector(), vector(), vector());
        let first = vertices.len() as i64;
        for (t, s) in [(-0.5, 0.0), (0.5, 0.0), (0.3, width)] {
            vertices.push([0, 1, 2].map(|axis| center[axis] + t * along[axis] + s * beside[axis]));
        }
        faces.extend(std::iter::repeat_n([first, first + 1, first + 2], 1 + usize::from(i % 50 == 0)));
    }
    mesh(&vertices, &faces)
}

/// A disc of slivers around its centre, bent by `bend`.
fn fan(count: usize, bend: f64) -> Mesh {
    let rim = (0..count).map(|i| {
        let angle = 2.0 * PI * i as f64 / count as f64;
        [angle.cos(), angle.sin(), bend * (5.0 * angle).sin()]
    });
    let vertices: Vec<[f64; 3]> = std::iter::once([0.0; 3]).chain(rim).collect();
    let count = count as i64;
    let faces: Vec<[i64; 3]> = (0..count).map(|i| [0, 1 + i, 1 + (i + 1) % count]).collect();
    mesh(&vertices, &faces)
}

#[test]
fn only_meshes_with_many_slivers_are_cut() {
    let (vertices, faces) = bumpy_sphere(3);
    assert!(!mesh(&vertices, &faces).moments().has_pieces());
    assert!(!fan(60, 0.1).moments().has_pieces());
}

/// Hundreds of discs over as many reversed ones: their winding numbers, and the winding numbers of their caps, exceed
/// the range of eight bits and nearly cancel.
#[test]
fn the_side_is_right_among_hundreds_of_openings() {
    const EDGES: i64 = 64;
    let (mut vertices, mut faces) = (Vec::<[f64; 3]>::new(), Vec::<[i64; 3]>::new());
    let mut add_disc = |z: f64, is_reversed: bool| {
        let first = vertices.len() as i64;
        vertices.push([0.0, 0.0, z]);
        vertices.extend((0..EDGES).map(|i| {
            let angle = 2.0 * PI * i as f64 / EDGES as f64;
            [angle.cos(), angle.sin(), z]
        }));
        faces.extend((0..EDGES).map(|i| {
            let (from, to) = (first + 1 + i, first + 1 + (i + 1) % EDGES);
            if is_reversed { [first, to, from] } else { [first, from, to] }
        }));
    };
    (0..300).for_each(|i| add_disc(-0.01 * f64::from(i) / 299.0, false));
    (0..311).for_each(|i| add_disc(-0.03 - 0.02 * f64::from(i) / 310.0, true));
    let mesh = mesh(&vertices, &faces);
    let p = mesh.local_from_world(DVec3::new(0.007, 0.011, 0.002));
    assert!(brute_force(&mesh, p).abs() < 0.4);
    let rule = SignChoice::new(&mesh, SignMethod::Auto).rule;
    let SignRule::Counted(openings) = &rule else { panic!("the openings are not closed by caps") };
    let winding = openings.winding(&mesh, p);
    assert!(winding.abs() > 128, "{winding}");
    assert_eq!(openings.rounded_ball(p).0, winding);
    let at = |_: [usize; 3]| p;
    let block = SampleBlock { low: [0; 3], high: [1; 3], at: &at };
    openings
        .for_each_rounded_fraction(&block, &Progress::new(), &mut |_, rounded| assert_eq!(rounded, winding))
        .unwrap();
    assert!(!rule.is_inside_without_distance(&mesh, p));
    assert!(!SideWalk::default().is_inside_without_distance(&rule, &mesh, p));
}

/// Rounding to float32 may move a point to the other side of a small cap. The skew openings are small against the mesh,
/// and most of the points are closer to a cap than this rounding.
#[test]
fn the_fraction_beside_a_small_cap_is_that_of_the_point() {
    let mut next = uniform(7);
    let (mut vertices, mut faces) = (Vec::<[f64; 3]>::new(), Vec::<[i64; 3]>::new());
    for i in 0..40 {
        let center = [0; 3].map(|_| next() - 0.5);
        vertices.extend((0..4).map(|_| center.map(|x| x + 1e-4 * (next() - 0.5))));
        faces.extend([[0, 1, 2], [0, 2, 3]].map(|face: [i64; 3]| face.map(|v| 4 * i + v)));
    }
    let mesh = mesh(&vertices, &faces);
    let openings = Openings::of(&mesh);
    assert_eq!(openings.caps.len(), 160);
    let mut decided = 0;
    for &cap in &openings.caps {
        let normal = triangle_cross(cap).normalize();
        for _ in 0..20 {
            let p = (cap[0] + cap[1] + cap[2]) / 3.0 + normal * (2e-8 * (next() - 0.5));
            let fraction = openings.fraction(p);
            // Nearer to 1/2 the side is open in any precision.
            if (fraction - fraction.round()).abs() < 0.44 {
                decided += 1;
                assert_eq!(openings.rounded_ball(p).0, fraction.round() as i32, "{p} {fraction}");
            }
        }
    }
    assert!(decided > 200, "{decided}");
}

#[test]
fn auto_takes_the_strongest_rule() {
    let (vertices, faces) = bumpy_sphere(1);
    let choose = |faces: &[[i64; 3]]| SignChoice::new(&mesh(&vertices, faces), SignMethod::Auto);
    assert!(matches!(choose(&faces).rule, SignRule::Counted(openings) if openings.caps.is_empty()));
    assert!(matches!(choose(&faces[1..]).rule, SignRule::Counted(openings) if openings.caps.len() == 3));
    let scattered: Vec<[i64; 3]> = faces.iter().copied().step_by(2).collect();
    assert!(matches!(choose(&scattered).rule, SignRule::Winding));
    let disc = SignChoice::new(&fan(3000, 0.1), SignMethod::Auto);
    assert!(matches!(disc.rule, SignRule::Counted(openings) if openings.caps.len() > 3000));
}

#[test]
fn unknown_methods_list_the_known_ones() {
    let error = "odd".parse::<SignMethod>().unwrap_err().to_string();
    assert!(error.starts_with("sign: must be one of \"auto\", \"winding\""), "{error}");
}
