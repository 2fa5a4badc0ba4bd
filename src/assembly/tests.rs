use super::clearance::{Clearance, Options, clearances};
use super::nearest::{Request, nearest};
use super::*;
use crate::csg::parts::solid::Solid;
use crate::csg::tree::primitive::Primitive;
use crate::csg::tree::shape::Shape;
use crate::geometry::closest_points_of_triangles;
use crate::progress::Progress;
use std::f64::consts::FRAC_1_SQRT_2;

/// The identity, row-major.
const IDENTITY: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

fn moved(by: [f64; 3]) -> [[f64; 4]; 4] {
    let mut rows = IDENTITY;
    (0..3).for_each(|axis| rows[axis][3] = by[axis]);
    rows
}

fn ball(radius: f64) -> Geometry {
    let shape = Shape::primitive(Primitive::named("sphere", &[radius]).unwrap());
    Geometry::Shape(Arc::new(ClosedForm::new(Arc::new(Solid::new(&shape).unwrap()))))
}

/// The cube from -1 to 1, or without its top face.
fn cube(is_open: bool) -> Geometry {
    let corner = |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { -1.0 } else { 1.0 });
    let corners: Vec<[f64; 3]> = (0..8).map(corner).collect();
    let sides = [[0, 2, 3, 1], [0, 1, 5, 4], [0, 4, 6, 2], [1, 3, 7, 5], [2, 6, 7, 3], [4, 5, 7, 6]];
    let kept = if is_open { &sides[..5] } else { &sides[..] };
    let faces: Vec<[i64; 3]> = kept.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Geometry::Mesh(Arc::new(Mesh::new(&corners, &faces).unwrap()))
}

/// Signed distance of the cube from -1 to 1.
fn cube_distance(p: DVec3) -> f64 {
    let away = p.abs() - 1.0;
    away.max(DVec3::ZERO).length() + away.max_element().min(0.0)
}

/// Distances and elements in the order of configurations and points.
fn distances_and_elements(bodies: &Bodies, request: &Request<'_>) -> (Vec<f64>, Vec<i64>) {
    let found = nearest(bodies, request, |found| found, &Progress::new()).unwrap();
    (found.column(|row| row.distance).unwrap(), found.column(|row| row.element).unwrap())
}

#[test]
fn a_rough_rotation_becomes_orthonormal() {
    let mut rows = IDENTITY;
    let (sine, cosine) = (FRAC_1_SQRT_2, FRAC_1_SQRT_2 + 4e-7);
    rows[0][..2].copy_from_slice(&[cosine, -sine]);
    rows[1][..2].copy_from_slice(&[sine, cosine]);

    let made = Similarity::from_rows(&rows, 1.0).rotation;

    let error = made.transpose() * made - DMat3::IDENTITY;
    assert!(error.to_cols_array().iter().all(|x| x.abs() <= 1e-12), "{error}");
    let rough = DVec3::new(rows[0][0], rows[1][0], 0.0);
    assert!((made.x_axis - rough).length() <= 1e-6);
}

#[test]
fn the_inverse_and_the_composition_of_similarities_are_those_of_points() {
    // A quarter turn about z with the factor 2, and a reflection of x with the factor 3.
    let turn = [[0.0, -2.0, 0.0, 1.0], [2.0, 0.0, 0.0, 2.0], [0.0, 0.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
    let flip = [[-3.0, 0.0, 0.0, 4.0], [0.0, 3.0, 0.0, 5.0], [0.0, 0.0, 3.0, 6.0], [0.0, 0.0, 0.0, 1.0]];
    let (turn, flip) = (Similarity::from_rows(&turn, 2.0), Similarity::from_rows(&flip, 3.0));
    let p = DVec3::new(0.5, -0.25, 2.0);

    // flip p = (2.5, 4.25, 12), and turn (x, y, z) = (1 - 2 y, 2 + 2 x, 3 + 2 z).
    assert!((turn.after(&flip).point(p) - DVec3::new(-7.5, 7.0, 27.0)).length() <= 1e-14);
    assert!((turn.after(&flip).scale - 6.0).abs() <= 1e-15);
    assert!((turn.after(&flip).inverse_point(DVec3::new(-7.5, 7.0, 27.0)) - p).length() <= 1e-14);
}

#[test]
fn the_smallest_distance_is_that_of_the_closed_forms() {
    let mut bodies = Bodies::new(2);
    bodies.add(0, ball(0.75), Similarity::from_rows(&moved([0.0, 0.0, 1.0]), 1.0), None);
    bodies.add(1, cube(false), Similarity::from_rows(&IDENTITY, 1.0), None);
    let poses = [IDENTITY, moved([3.0, 0.0, 0.0]), moved([0.0, 2.0, 0.0]), IDENTITY];
    let points: Vec<[f64; 3]> =
        (0..7 * 7 * 7).map(|i| [i % 7, i / 7 % 7, i / 49].map(|step| f64::from(step) * 1.25 - 3.1)).collect();
    let request = Request { poses: &poses, configurations: 2, points: &points, is_paired: false, searched: &[true; 2] };

    let (distances, elements) = distances_and_elements(&bodies, &request);

    for (row, (&distance, &element)) in distances.iter().zip(&elements).enumerate() {
        let p = DVec3::from_array(points[row % points.len()]);
        let (center, shift) = if row < points.len() {
            (DVec3::Z, DVec3::new(3.0, 0.0, 0.0))
        } else {
            (DVec3::new(0.0, 2.0, 1.0), DVec3::ZERO)
        };
        let truth = [(p - center).length() - 0.75, cube_distance(p - shift)];
        assert!((distance - truth[0].min(truth[1])).abs() <= 1e-12, "{p}: {distance}, {truth:?}");
        assert_eq!(element, i64::from(truth[1] < truth[0]));
    }
}

#[test]
fn paired_points_belong_to_one_configuration_each() {
    let mut bodies = Bodies::new(1);
    bodies.add(0, ball(1.0), Similarity::from_rows(&IDENTITY, 1.0), None);
    let poses = [IDENTITY, moved([10.0, 0.0, 0.0])];
    let points = [[3.0, 0.0, 0.0], [0.0, 0.5, 0.0], [3.0, 0.0, 0.0], [10.0, 0.5, 0.0]];
    let request = Request { poses: &poses, configurations: 2, points: &points, is_paired: true, searched: &[true] };

    assert_eq!(distances_and_elements(&bodies, &request).0, [2.0, -0.5, 6.0, -0.5]);
}

#[test]
fn bodies_that_are_not_searched_have_no_distance() {
    let mut bodies = Bodies::new(2);
    bodies.add(0, ball(1.0), Similarity::from_rows(&IDENTITY, 1.0), None);
    bodies.add(1, cube(true), Similarity::from_rows(&moved([0.0, 0.0, 5.0]), 1.0), None);
    let points = [[0.0, 0.0, 2.0]];
    let found = |searched: [bool; 2]| {
        let poses = [IDENTITY; 2];
        let request =
            Request { poses: &poses, configurations: 1, points: &points, is_paired: false, searched: &searched };
        let (distances, elements) = distances_and_elements(&bodies, &request);
        (distances[0], elements[0])
    };

    assert_eq!(found([true, true]), (1.0, 0));
    assert_eq!(found([false, true]), (2.0, 1));
    assert_eq!(found([false, false]), (f64::INFINITY, -1));
    // An open mesh has no box around its inside.
    assert!(bodies.elements[1].bounds.is_none());
    assert!(bodies.elements[0].bounds.is_some());
}

/// A closed form of one primitive.
fn shape(kind: &str, sizes: &[f64]) -> Geometry {
    let shape = Shape::primitive(Primitive::named(kind, sizes).unwrap());
    Geometry::Shape(Arc::new(ClosedForm::new(Arc::new(Solid::new(&shape).unwrap()))))
}

/// The clearance of two geometries, the second one with a pose.
fn clearance_of(first: Geometry, second: Geometry, pose: [[f64; 4]; 4], cutoff: f64) -> Clearance {
    let mut bodies = Bodies::new(2);
    bodies.add(0, first, Similarity::from_rows(&IDENTITY, 1.0), None);
    bodies.add(1, second, Similarity::from_rows(&IDENTITY, 1.0), None);
    let options = Options { cutoff, relative_tolerance: 1e-3 };
    clearances(&bodies, &[IDENTITY, pose], &[[0, 1]], &options, &Progress::default()).unwrap()[0]
}

/// A turn by 0.6 about the z axis and then by 0.9 about the x axis, and a translation.
fn tilted(by: [f64; 3]) -> [[f64; 4]; 4] {
    let turn = DMat3::from_rotation_x(0.9) * DMat3::from_rotation_z(0.6);
    let mut rows = moved(by);
    (0..3).for_each(|i| (0..3).for_each(|j| rows[i][j] = turn.col(j)[i]));
    rows
}

#[test]
fn separate_meshes_have_the_smallest_distance_of_their_triangles() {
    let pose = tilted([2.6, 1.9, 1.4]);
    let place = Similarity::from_rows(&pose, 1.0);
    let (Geometry::Mesh(a), Geometry::Mesh(b)) = (cube(false), cube(false)) else { unreachable!() };
    let corners = |mesh: &Mesh, face: &[u32; 3]| face.map(|v| DVec3::from_array(mesh.world_positions()[v as usize]));
    let mut least = f64::INFINITY;
    for first in a.faces() {
        for second in b.faces() {
            let other = corners(&b, second).map(|p| place.point(p));
            least = least.min(closest_points_of_triangles(corners(&a, first), other).0);
        }
    }

    let found = clearance_of(Geometry::Mesh(a), Geometry::Mesh(b), pose, f64::INFINITY);

    assert!(least > 0.1);
    assert!((found.distance - least).abs() <= 1e-14, "{} instead of {least}", found.distance);
    assert!(found.error == 0.0);
    let [p, q] = found.points.map(DVec3::from_array);
    assert!((p.distance(q) - least).abs() <= 1e-14);
    assert!(cube_distance(p).abs() <= 1e-14);
    assert!(cube_distance(place.inverse_point(q)).abs() <= 1e-14);
}

#[test]
fn convex_shapes_that_are_apart_have_a_proven_distance() {
    let kinds: [(&str, &[f64]); 4] = [
        ("cylinder", &[0.4, 1.1]),
        ("cone", &[0.6, 0.0, 1.2]),
        ("ellipsoid", &[0.9, 0.4, 0.6]),
        ("box", &[0.7, 0.9, 0.5]),
    ];
    for (first, a) in kinds {
        for (second, b) in kinds {
            let found = clearance_of(shape(first, a), shape(second, b), tilted([0.9, 1.3, 0.6]), f64::INFINITY);
            let [p, q] = found.points.map(DVec3::from_array);
            assert!(found.distance > 0.1, "{first} {second}: {}", found.distance);
            assert!((p.distance(q) - found.distance).abs() <= 1e-14);
            assert!(found.error <= 1e-12, "{first} {second}: {}", found.error);
        }
    }
}

#[test]
fn the_depth_of_an_overlap_is_the_largest_ball() {
    // The overlap is a slab with the thickness 0.3, and the ball of a ball in a cube touches three sides.
    let slab = clearance_of(cube(false), cube(false), moved([0.4, 0.2, 1.7]), f64::INFINITY);
    assert!((slab.distance + 0.3).abs() <= 3e-4, "{}", slab.distance);
    assert!(slab.error <= 3.1e-4);
    let nested = clearance_of(cube(false), ball(0.25), moved([0.5, 0.5, 0.5]), f64::INFINITY);
    assert!((nested.distance + 0.5).abs() <= 5e-4, "{}", nested.distance);
    // Two balls on one line are exact.
    let balls = clearance_of(ball(1.0), ball(0.5), moved([0.0, 1.2, 0.0]), f64::INFINITY);
    assert!((balls.distance + 0.3).abs() <= 1e-15);
    assert!(balls.error == 0.0);
}

#[test]
fn a_pair_beyond_the_cutoff_has_a_bound_and_no_points() {
    let far = clearance_of(cube(false), shape("cone", &[0.5, 0.0, 1.0]), moved([4.0, 0.0, 0.0]), 0.75);
    assert!((0.75..=2.5).contains(&far.distance), "{}", far.distance);
    assert!(far.error == f64::INFINITY);
    assert!(far.points.iter().flatten().all(|x| x.is_nan()));
}
