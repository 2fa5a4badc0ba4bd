use super::build::SparseOptions;
use super::*;
use crate::volume::tests::fill;
use proptest::prelude::*;

fn sphere(shape: [usize; 3]) -> (Grid, Vec<f32>) {
    let grid = Grid::new(DVec3::splat(-1.3), DVec3::splat(1.3), shape).unwrap();
    let distances = fill(&grid, |p| p.length() - 1.0);
    (grid, distances)
}

fn sparse<T: Texel>(grid: Grid, distances: &[f32], tolerance: Option<f64>) -> SparseField<T> {
    let view = FieldView::new(grid, distances).unwrap();
    let options = SparseOptions { band: 3.0, tolerance };
    view.to_sparse([DVec3::NEG_ONE, DVec3::ONE], &options, &Progress::new()).unwrap()
}

#[test]
fn words_of_the_index_come_back() {
    for entry in [
        Entry::Stored { level: 0, brick: 0 },
        Entry::Stored { level: 2, brick: BRICK_MASK },
        Entry::Empty { inside: false },
        Entry::Empty { inside: true },
    ] {
        assert_eq!(Entry::from_word(entry.to_word()), entry);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn noise_is_stored_to_the_bit(shape in prop::array::uniform3(1..20usize), seed in prop::collection::vec(-0.05..0.05f32, 64)) {
        // The box is smaller than the band, so every brick is stored.
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, shape).unwrap();
        let distances: Vec<f32> = (0..grid.len()).map(|i| seed[i * 31 % 64]).collect();
        let field = sparse::<f32>(grid, &distances, Some(0.0));
        prop_assert_eq!(field.view().unwrap().dense(&Progress::new()).unwrap(), distances);
    }
}

#[test]
fn a_coarser_brick_gives_its_own_value_between_its_samples() {
    let samples: [f32; BRICK_LEN] = std::array::from_fn(|i| (i * 7919 % 101) as f32);
    for level in 0..=MAX_LEVEL {
        let steps = 1 << level;
        for cell in [0, 3, BRICK_CELLS] {
            let at = [cell, 2, 5];
            let stored = samples[at[0] + BRICK_SAMPLES * (at[1] + BRICK_SAMPLES * at[2])];
            assert_eq!(coarse_value(&samples, at.map(|i| i * steps), level), stored);
        }
    }
}

#[test]
fn empty_bricks_bound_a_sphere() {
    let (grid, distances) = sphere([60, 61, 62]);
    let field = sparse::<f32>(grid, &distances, None);
    let view = field.view().unwrap();
    let mut looked_at = 0;
    for i in 0..20_000 {
        // Points of a lattice that shares no plane with the grid.
        let p = DVec3::new((i % 27) as f64, (i / 27 % 27) as f64, (i / 729) as f64) / 27.0 * 5.0 - 2.45;
        let (value, truth) = (f64::from(view.sample_linear(p)), p.length() - 1.0);
        let is_empty = |p| matches!(view.entry_of_cell(p), Entry::Empty { .. });
        if !view.contains(p) {
            let bound = f64::from(view.distance_bound(p, [DVec3::NEG_ONE, DVec3::ONE]));
            assert!(bound <= truth + 1e-6 && bound > 0.0);
        } else if is_empty(view.grid_from_world(p).floor().as_ivec3()) {
            assert!(value.abs() <= truth.abs() + 1e-6 && value * truth > 0.0, "{p}: {value} {truth}");
            assert!(value.abs() >= view.floor - 1e-6);
            looked_at += 1;
        }
    }
    assert!(looked_at > 500, "{looked_at}");
}

#[test]
fn arrays_that_do_not_belong_together_are_refused() {
    let (grid, distances) = sphere([20, 20, 20]);
    let good = sparse::<i8>(grid, &distances, None);
    let told = |change: &dyn Fn(&mut SparseField<i8>)| {
        let mut field = good.clone();
        change(&mut field);
        field.view().unwrap_err().to_string()
    };
    assert!(told(&|field| field.index[1] = 1 << 20).starts_with("index: [1] refers to brick 1048576"));
    assert!(told(&|field| field.index.truncate(3)).starts_with("index: "));
    assert!(told(&|field| field.texels.truncate(3)).starts_with("bricks: "));
    assert!(told(&|field| field.scale = f32::NAN).starts_with("scale: "));
    assert!(told(&|field| field.band = 0.0).starts_with("band: "));
    let view = FieldView::new(grid, &distances).unwrap();
    let options = SparseOptions { band: 1.0, tolerance: None };
    assert!(view.to_sparse::<f32>([DVec3::NEG_ONE, DVec3::ONE], &options, &Progress::new()).is_err());
}
