//! Which kinds of things a scene holds, and the text of its kernels: they know those kinds and no others.
//!
//! Software devices execute every branch, and all of them put functions in place of their calls: a kernel that knows a kind
//! pays for it wherever it asks a field. So a scene of dense grids has the kernels as they are, and other scenes have other
//! files in the place of some that those import.

use crate::gpu::shader::Instead;

/// As in `shaders/shared/scene_field.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Dense = 0,
    Sparse = 1,
    Quadric = 2,
}

/// The kinds of a scene's things, besides dense grids.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Kinds {
    pub sparse: bool,
    pub quadrics: bool,
}

impl Kinds {
    pub fn add(&mut self, kind: Kind) {
        match kind {
            Kind::Dense => {}
            Kind::Sparse => self.sparse = true,
            Kind::Quadric => self.quadrics = true,
        }
    }

    /// The files that kernels import in place of others.
    pub fn files(self) -> Vec<Instead> {
        let instead =
            [(self.sparse, ("scene_samples", "scene_sparse")), (self.quadrics, ("scene_things", "scene_quadric"))];
        instead.into_iter().filter(|(is_held, _)| *is_held).map(|(_, files)| files).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::shader::source_of_files;
    use crate::gpu::tests::validate;

    #[test]
    fn every_text_is_valid() {
        for (sparse, quadrics) in [(false, false), (false, true), (true, false), (true, true)] {
            for kernel in ["scene_beams", "scene_fields"] {
                let text = source_of_files(kernel, &Kinds { sparse, quadrics }.files()).unwrap();
                validate(kernel, &text);
                assert_eq!(text.contains("fn quadric_hit"), quadrics);
                assert_eq!(text.contains("fn march_bricks"), sparse);
            }
        }
    }
}
