//! The components of the scene's passes compared with closed forms.

use crate::scene::content::instance::singular_values;
use crate::scene::light::cone::visible_share;
use crate::scene::light::light_rays::{basis, disc_point};
use glam::{DMat3, DVec3};
use proptest::prelude::*;

proptest! {
    #[test]
    fn singular_values_are_those_of_a_turned_scale(
        scale in prop::array::uniform3(0.01..10.0f64), angles in prop::array::uniform4(-3.0..3.0f64)
    ) {
        let turn = |a: f64, b: f64| DMat3::from_rotation_x(a) * DMat3::from_rotation_y(b);
        let m = turn(angles[0], angles[1]) * DMat3::from_diagonal(DVec3::from_array(scale)) * turn(angles[2], angles[3]);
        let [least, largest] = singular_values(m);
        let scale = DVec3::from_array(scale);
        // Squaring the matrix halves the digits of the least against the largest.
        prop_assert!((least - scale.min_element()).abs() < 1e-7 * scale.max_element());
        prop_assert!((largest - scale.max_element()).abs() < 1e-9 * scale.max_element());
    }

    #[test]
    fn a_basis_is_orthonormal(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64) {
        let n = DVec3::new(x, y, z).normalize_or(DVec3::NEG_Z);
        let [right, up] = basis(n);
        for (a, b, product) in [(right, right, 1.0), (up, up, 1.0), (right, up, 0.0), (right, n, 0.0), (up, n, 0.0)] {
            prop_assert!((a.dot(b) - product).abs() < 1e-9);
        }
    }
}

#[test]
fn the_visible_share_is_that_of_a_disc_cut_by_a_chord() {
    for i in -100..=100 {
        let x = f64::from(i) / 100.0;
        let exact = 0.5 + (x.asin() + x * (1.0 - x * x).sqrt()) / std::f64::consts::PI;
        assert!((f64::from(visible_share(x as f32)) - exact).abs() < 0.004, "{x}");
    }
    assert_eq!((visible_share(-1.0), visible_share(1.0)), (0.0, 1.0));
}

#[test]
fn disc_points_are_spread_evenly() {
    // Their second moments equal the moments of the disc: 1/4 on each axis.
    let points: Vec<_> = (0..256).map(|i| disc_point(i, 256, 0.7)).collect();
    let mean = |f: &dyn Fn(&glam::Vec2) -> f32| points.iter().map(f).sum::<f32>() / 256.0;
    assert!((mean(&|p| p.x * p.x) - 0.25).abs() < 0.01 && (mean(&|p| p.x * p.y)).abs() < 0.01);
    assert!(points.iter().all(|p| p.length() < 1.0));
}
