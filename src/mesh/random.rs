//! Random numbers and meshes for tests, the same in every run.

use super::Mesh;

/// Numbers from 0 to 1 of a small linear congruential generator, whose quality is sufficient for tests.
pub(crate) fn uniform(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed | 1;
    move || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    }
}

/// A soup of `count` triangles of about `size`, most of them within the cube from -1/2 to 1/2.
pub(crate) fn soup(count: usize, size: f64, seed: u64) -> Mesh {
    let mut uniform = uniform(seed);
    let mut next = || uniform() - 0.5;
    let vertices: Vec<[f64; 3]> = (0..count)
        .flat_map(|_| {
            let center = [next(), next(), next()];
            [0; 3].map(|_| center.map(|x| x + size * next()))
        })
        .collect();
    Mesh::new(&vertices, &(0..count as i64).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect::<Vec<_>>()).unwrap()
}
