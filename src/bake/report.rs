//! What a bake found and did.

use crate::mesh::Mesh;
use crate::mesh::topology::Topology;
use crate::sign::SignChoice;

/// Facts about the mesh, the method and the cost of a bake.
#[derive(Debug, Clone, Default)]
pub struct Report {
    pub sign_method: &'static str,
    pub sign_reason: String,
    pub boundary_edges: usize,
    pub nonmanifold_edges: usize,
    pub flipped_faces: usize,
    pub duplicate_faces: usize,
    pub degenerate_faces: usize,
    pub dropped_vertices: usize,
    pub components: usize,
    pub closed: bool,
    /// Samples where the sign rule was close to undecided.
    pub undecided_voxels: usize,
    pub inside_voxels: usize,
    pub device: String,
    /// Stage and seconds, in the order they ran.
    pub seconds: Vec<(&'static str, f64)>,
    /// Output, mesh, tree and working memory at their largest.
    pub peak_bytes: usize,
    pub warnings: Vec<String>,
}

impl Report {
    pub fn new(mesh: &Mesh, topology: &Topology, choice: &SignChoice) -> Self {
        let mut report = Self {
            sign_method: choice.method.name(),
            sign_reason: choice.reason.clone(),
            boundary_edges: topology.boundary_edges,
            nonmanifold_edges: topology.nonmanifold_edges,
            flipped_faces: topology.flipped_faces,
            duplicate_faces: topology.duplicate_faces,
            degenerate_faces: mesh.degenerate_faces().len(),
            dropped_vertices: mesh.dropped_vertices(),
            components: topology.components,
            closed: topology.closed,
            ..Self::default()
        };
        if topology.closed && topology.signed_volume < 0.0 {
            report.warnings.push("the mesh is inside out; it was read as the same solid, right side out".into());
        }
        if topology.flipped_faces > 0 {
            let count = topology.flipped_faces;
            report
                .warnings
                .push(format!("{count} faces are wound against their neighbours; they were turned for the sign"));
        }
        if topology.unorientable_patches > 0 {
            let count = topology.unorientable_patches;
            report.warnings.push(format!(
                "{count} patches cannot be oriented (one-sided surface); the sign there is a convention"
            ));
        }
        report
    }

    /// Look at the finished signs.
    pub fn finish(&mut self, inside: usize, undecided: usize) {
        self.inside_voxels = inside;
        self.undecided_voxels = undecided;
        let signed = self.sign_method != "unsigned";
        if signed && inside == 0 && !self.closed {
            self.warnings.push(
                "no sample is inside: the mesh is a sheet, or too thin for this resolution; use two_sided=True".into(),
            );
        } else if signed && !self.closed {
            let edges = self.boundary_edges;
            self.warnings.push(format!(
                "the surface is open ({edges} boundary edges): inside is where its winding number exceeds 1/2"
            ));
        }
    }
}
