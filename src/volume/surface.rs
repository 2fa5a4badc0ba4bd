//! A level set as a triangle mesh: naive surface nets (Gibson 1998), by the crate `fast-surface-nets`.
//!
//! One vertex per cell that the surface crosses, the mean of the crossings of its edges; one quad per grid edge that
//! changes sign. Vertices lie within half a voxel diagonal of the trilinear surface, sharp edges become round.
//!
//! The grid is wrapped in a layer of samples, each the mirror value of its neighbour in the box: `|d - level|`.
//! A surface inside the box is untouched. A surface that leaves the box is closed by a cap exactly on the face of the
//! box (a sample `-v` inside and `+v` outside cross half way), so the mesh is always closed: it is the solid "below
//! the level and in the box".

use super::{FieldView, Trilinear};
use crate::error::{ArgumentError, Error};
use fast_surface_nets::ndshape::{RuntimeShape, Shape};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::DVec3;

/// Triangles of a level set.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceMesh {
    /// World positions.
    pub vertices: Vec<DVec3>,
    /// Counter-clockwise seen from outside, the side of larger values.
    pub faces: Vec<[u32; 3]>,
}

impl FieldView<'_> {
    /// The surface where the field equals `level`. Fails where the field has no value below the level, or none at or
    /// above it: there is no surface to return then.
    pub fn surface_nets(&self, level: f32) -> Result<SurfaceMesh, Error> {
        self.check_level(level)?;
        let shape = self.padded_shape()?;
        let samples = self.padded_samples(&shape, level);
        let [nx, ny, nz] = shape.as_array();
        let mut buffer = SurfaceNetsBuffer::default();
        surface_nets(&samples, &shape, [0; 3], [nx - 1, ny - 1, nz - 1], &mut buffer);

        // Padded sample 1 is voxel 0, whose centre is half a voxel from the corner of the box.
        let (lower, h) = (self.grid().lower, self.grid().spacing());
        let world_from_padded = |p: &[f32; 3]| lower + (DVec3::new(p[0] as f64, p[1] as f64, p[2] as f64) - 0.5) * h;
        Ok(SurfaceMesh {
            vertices: buffer.positions.iter().map(world_from_padded).collect(),
            faces: buffer.indices.chunks_exact(3).map(|corner| [corner[0], corner[1], corner[2]]).collect(),
        })
    }

    fn check_level(&self, level: f32) -> Result<(), Error> {
        let mut lowest = f32::INFINITY;
        let mut highest = f32::NEG_INFINITY;
        let mut all_finite = true;
        for &distance in self.distances() {
            lowest = lowest.min(distance);
            highest = highest.max(distance);
            all_finite &= distance.is_finite();
        }
        if !all_finite {
            return Err(ArgumentError::new("distances", "must be finite").into());
        }
        if !level.is_finite() {
            return Err(ArgumentError::new("level", format!("must be finite, got {level}")).into());
        }
        if !(lowest < level && level <= highest) {
            let problem = format!("{level} gives no surface, the distances range from {lowest} to {highest}");
            return Err(ArgumentError::new("level", problem).into());
        }
        Ok(())
    }

    /// The shape with one more sample on the lower sides and two on the upper, where the crate makes no quads for the
    /// last edge; positions in it are u32 in the crate.
    fn padded_shape(&self) -> Result<RuntimeShape<u32, 3>, Error> {
        let padded = self.grid().shape.map(|n| n as u64 + 3);
        let samples = padded.iter().try_fold(1u64, |product, &n| product.checked_mul(n));
        if samples.is_none_or(|n| n > u32::MAX as u64) {
            let problem = format!("{:?} voxels are too many for one mesh (2^32); downsample first", self.grid().shape);
            return Err(ArgumentError::new("distances", problem).into());
        }
        Ok(RuntimeShape::<u32, 3>::new(padded.map(|n| n as u32)))
    }

    fn padded_samples(&self, shape: &RuntimeShape<u32, 3>, level: f32) -> Vec<f32> {
        let grid = self.grid();
        let [px, py, pz] = shape.as_array().map(|n| n as usize);
        let mut samples = Vec::with_capacity(px * py * pz);
        for z in 0..pz {
            for y in 0..py {
                for x in 0..px {
                    let inside = |i: usize, n: usize| (1..=n).contains(&i);
                    let nearest = |i: usize, n: usize| i.clamp(1, n) - 1;
                    let [nx, ny, nz] = grid.shape;
                    let value = self.distances()[grid.offset(nearest(x, nx), nearest(y, ny), nearest(z, nz))] - level;
                    let in_box = inside(x, nx) && inside(y, ny) && inside(z, nz);
                    samples.push(if in_box { value } else { value.abs() });
                }
            }
        }
        samples
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::fill;
    use super::*;
    use crate::grid::Grid;
    use std::collections::HashMap;
    use std::f64::consts::PI;

    fn signed_volume(mesh: &SurfaceMesh) -> f64 {
        let corner = |i: u32| mesh.vertices[i as usize] - mesh.vertices[0];
        mesh.faces.iter().map(|&[a, b, c]| corner(a).dot(corner(b).cross(corner(c))) / 6.0).sum()
    }

    /// Every directed edge has its opposite.
    fn is_closed(mesh: &SurfaceMesh) -> bool {
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for &[a, b, c] in &mesh.faces {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((from, to)).or_default() += 1;
                *edges.entry((to, from)).or_default() -= 1;
            }
        }
        edges.values().all(|&balance| balance == 0)
    }

    #[test]
    fn a_sphere_on_oblong_voxels_comes_back_closed_and_outward() {
        let grid = Grid::new(DVec3::new(99.0, -1.3, -1.2), DVec3::new(101.4, 1.3, 1.2), [24, 40, 30]).unwrap();
        let center = DVec3::new(100.2, 0.0, 0.0);
        let distances = fill(&grid, |p| (p - center).length() - 1.0);
        let mesh = FieldView::new(grid, &distances).unwrap().surface_nets(0.0).unwrap();
        assert!(is_closed(&mesh));
        // Off by at most half a voxel diagonal; far less on a smooth surface.
        let diagonal = grid.spacing().length();
        assert!(mesh.vertices.iter().all(|&p| ((p - center).length() - 1.0).abs() < 0.5 * diagonal));
        // Surface nets cut the corners of a curve: the solid shrinks by less than a tenth of a voxel all round.
        let volume = signed_volume(&mesh);
        let sphere = 4.0 / 3.0 * PI;
        assert!(volume < sphere && volume > sphere - 4.0 * PI * 0.1 * grid.spacing().max_element(), "{volume}");
    }

    #[test]
    fn another_level_is_an_offset_surface() {
        let grid = Grid::new(DVec3::splat(-1.5), DVec3::splat(1.5), [30, 30, 30]).unwrap();
        let distances = fill(&grid, |p| p.length() - 1.0);
        let mesh = FieldView::new(grid, &distances).unwrap().surface_nets(-0.5).unwrap();
        assert!(mesh.vertices.iter().all(|p| (p.length() - 0.5).abs() < 0.5 * grid.spacing().length()));
    }

    #[test]
    fn a_surface_that_leaves_the_box_is_capped_on_its_face() {
        // The half space below z = 0.3 fills the box up to there.
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [8, 8, 8]).unwrap();
        let distances = fill(&grid, |p| p.z - 0.3);
        let mesh = FieldView::new(grid, &distances).unwrap().surface_nets(0.0).unwrap();
        assert!(is_closed(&mesh));
        let lower = mesh.vertices.iter().copied().reduce(DVec3::min).unwrap();
        assert!((lower - DVec3::ZERO).abs().max_element() < 1e-6);
        // Round edges: each of the 8 box edges of the solid loses less than half a voxel square.
        let volume = signed_volume(&mesh);
        assert!(volume < 0.3 && volume > 0.3 - 9.2 * 0.5 / 64.0, "{volume}");
    }

    #[test]
    fn a_level_without_a_surface_is_refused_with_the_range() {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [2, 1, 1]).unwrap();
        let field = FieldView::new(grid, &[1.0, 2.0]).unwrap();
        assert_eq!(
            field.surface_nets(0.0).unwrap_err().to_string(),
            "level: 0 gives no surface, the distances range from 1 to 2"
        );
        assert!(field.surface_nets(1.0).is_err());
        assert!(field.surface_nets(2.0).is_ok());
        assert!(field.surface_nets(f32::NAN).is_err());
        assert!(FieldView::new(grid, &[1.0, f32::NAN]).unwrap().surface_nets(1.5).is_err());
    }
}
