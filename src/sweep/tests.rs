use super::motion::{JointKind, Step};
use super::*;
use glam::{DMat3, DQuat};
use std::f64::consts::PI;

fn pose(rotation: DMat3, translation: DVec3) -> Similarity {
    Similarity { rotation, translation, scale: 1.0 }
}

/// Numbers in [-1, 1) from a linear congruential generator.
fn random(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

fn random_vector(state: &mut u64) -> DVec3 {
    DVec3::new(random(state), random(state), random(state))
}

/// The largest speed of a fixed point in the frame of the body on an interval, by small differences.
fn fastest(step: &Step, p: DVec3, from: f64, to: f64) -> f64 {
    let h = 1e-6;
    let at = |s: f64| step.at(s).inverse_point(p);
    (0..=50)
        .map(|i| from + (to - from) * f64::from(i) / 50.0)
        .map(|s| (at(s + h) - at(s - h)).length() / (2.0 * h))
        .fold(0.0, f64::max)
}

#[test]
fn a_screw_ends_at_both_poses_and_halves_are_equal() {
    let mut state = 1;
    for case in 0..2000 {
        // Small, moderate and nearly half turns.
        let angle = [1e-9, 1e-3, 0.099, 0.101, 1.0, PI - 2e-6][case % 6];
        let axis = random_vector(&mut state).normalize();
        let first = DQuat::from_axis_angle(random_vector(&mut state).normalize(), random(&mut state));
        let start = pose(DMat3::from_quat(first), 10.0 * random_vector(&mut state));
        let end = pose(DMat3::from_axis_angle(axis, angle) * start.rotation, random_vector(&mut state));
        let step = Step::Screw(Screw::between(start, end, random_vector(&mut state)).unwrap());

        for (s, truth) in [(0.0, start), (1.0, end)] {
            let made = step.at(s);
            assert!((made.translation - truth.translation).length() <= 1e-9, "{angle} {s}");
            assert!((made.rotation - truth.rotation).to_cols_array().iter().all(|x| x.abs() <= 1e-9));
        }
        // The motion from the start to the middle is that from the middle to the end.
        let middle = step.at(0.5);
        let p = random_vector(&mut state);
        let once = middle.point(start.inverse_point(middle.point(p)));
        assert!((once - end.point(p)).length() <= 1e-9, "{angle}: {once} {}", end.point(p));
    }
}

#[test]
fn half_a_turn_has_no_screw() {
    let start = pose(DMat3::IDENTITY, DVec3::ZERO);
    let end = |angle: f64| pose(DMat3::from_rotation_z(angle), DVec3::X);
    assert!(Screw::between(start, end(PI), DVec3::ZERO).is_none());
    assert!(Screw::between(start, end(PI - 1e-7), DVec3::ZERO).is_none());
    assert!(Screw::between(start, end(PI - 2e-6), DVec3::ZERO).is_some());
}

#[test]
fn the_speed_of_a_screw_is_that_of_its_points() {
    // A turn of 2 about the line through (1, 0, 0) along z, with a slide of 3.
    let start = pose(DMat3::IDENTITY, DVec3::ZERO);
    let turned = DMat3::from_rotation_z(2.0);
    let end = pose(turned, DVec3::X - turned * DVec3::X + DVec3::new(0.0, 0.0, 3.0));
    let step = Step::Screw(Screw::between(start, end, DVec3::new(5.0, 1.0, -2.0)).unwrap());

    assert!((step.speed(DVec3::new(1.0, 0.0, 7.0)) - 3.0).abs() <= 1e-12);
    assert!((step.speed(DVec3::new(1.0, 2.0, -1.0)) - 5.0).abs() <= 1e-12);
    assert!((step.turn() - 2.0).abs() <= 1e-12);
    let p = DVec3::new(0.3, -2.0, 1.0);
    assert!((fastest(&step, p, 0.0, 1.0) - step.speed(p)).abs() <= 1e-6);
}

#[test]
fn no_point_is_faster_than_the_bound_of_joints() {
    let mut state = 7;
    let mut largest: f64 = 0.0;
    for case in 0..300 {
        let joints = (0..1 + case % 5).map(|_| {
            let turn = DQuat::from_axis_angle(random_vector(&mut state).normalize(), random(&mut state) * 3.0);
            let origin = pose(DMat3::from_quat(turn), random_vector(&mut state));
            let axis = random_vector(&mut state).normalize();
            let kind = if random(&mut state) < -0.4 { JointKind::Prismatic(axis) } else { JointKind::Revolute(axis) };
            (origin, kind)
        });
        let joints: Vec<_> = joints.collect();
        let values = joints.iter().map(|_| [random(&mut state) * 2.0, random(&mut state) * 2.0]).collect();
        let root = pose(DMat3::IDENTITY, random_vector(&mut state));
        let step = Step::Joints(JointStep::new(Arc::new(Chain { root, joints }), values));
        for _ in 0..3 {
            let p = random_vector(&mut state) * 3.0;
            assert!(fastest(&step, p, 0.0, 1.0) <= step.speed(p) + 1e-6);
            let from = 0.5 + 0.5 * random(&mut state);
            let to = from + (1.0 - from) * (0.5 + 0.5 * random(&mut state));
            let bound = step.middle(p, from, to).1;
            let truth = fastest(&step, p, from, to);
            assert!(truth <= bound + 1e-6, "{truth} {bound}");
            largest = largest.max(truth / bound);
            // The bound changes by at most `turn` with the position of the point.
            let q = p + random_vector(&mut state);
            assert!((step.speed(q) - step.speed(p)).abs() <= step.turn() * q.distance(p) + 1e-12);
            // A point of the body, in the world.
            let h = 1e-6;
            let speed = (step.at(from + h).point(p) - step.at(from - h).point(p)).length() / (2.0 * h);
            assert!(speed <= step.speed_of_body_point(p) + 1e-6);
        }
    }
    // A single joint whose point lies in the plane through its place attains the bound.
    assert!(largest > 0.8 && largest <= 1.0 + 1e-6, "{largest}");
}
