//! The report of a bake: properties of the mesh, decisions and cost.

use crate::grid::Grid;
use crate::mesh::Mesh;
use crate::mesh::topology::Topology;
use crate::sign::{SignChoice, SignMethod};

/// Facts about the mesh, the method and the cost of a bake.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// Name of the method for the signs.
    pub sign_method: &'static str,
    /// Reason for the choice of the method.
    pub sign_reason: String,
    /// Number of faces with an area.
    pub faces: usize,
    /// Number of edges with one face.
    pub boundary_edges: usize,
    /// Number of edges with more than two faces.
    pub nonmanifold_edges: usize,
    /// Number of faces that were flipped to agree with their neighbours.
    pub flipped_faces: usize,
    /// Number of faces that occur more than once.
    pub duplicate_faces: usize,
    /// Number of faces without area.
    pub degenerate_faces: usize,
    /// Number of vertices without faces.
    pub dropped_vertices: usize,
    /// Number of connected components.
    pub components: usize,
    /// Whether each edge is used once in each direction.
    pub closed: bool,
    /// Number of samples where the sign rule was close to undecided.
    pub undecided_voxels: usize,
    /// Number of samples with a negative distance.
    pub inside_voxels: usize,
    /// Number of points of a query.
    pub points: usize,
    /// Number of queried points inside.
    pub inside_points: usize,
    /// Name of the device.
    pub device: String,
    /// Name and seconds of each stage, in the order of execution.
    pub seconds: Vec<(&'static str, f64)>,
    /// Peak memory of output, mesh, tree and working buffers, bytes.
    pub peak_bytes: usize,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

impl Report {
    /// The report of a mesh before a bake or query.
    pub fn new(mesh: &Mesh, topology: &Topology, choice: &SignChoice) -> Self {
        let mut report = Self {
            sign_method: choice.method.name(),
            sign_reason: choice.reason.clone(),
            faces: mesh.faces_with_area(),
            boundary_edges: topology.boundary_edges,
            nonmanifold_edges: topology.nonmanifold_edges,
            flipped_faces: topology.flipped_faces,
            duplicate_faces: topology.duplicate_faces,
            degenerate_faces: mesh.degenerate_faces(),
            dropped_vertices: mesh.dropped_vertices(),
            components: topology.components,
            closed: topology.closed,
            ..Self::default()
        };
        report.warnings = orientation_warnings(mesh);
        report
    }

    /// The report of a query with `points` points, of which `inside` are inside.
    pub fn of_query(mesh: &Mesh, choice: &SignChoice, points: usize, inside: usize) -> Self {
        let mut report = Self::new(mesh, mesh.topology(), choice);
        report.points = points;
        report.inside_points = inside;
        report.warnings = sign_warnings(mesh, choice.method);
        report
    }

    /// Records the signs of a bake on `grid`, and warns about a thickness that the grid cannot represent.
    pub fn finish(&mut self, inside: usize, undecided: usize, thickness: Option<f64>, grid: &Grid) {
        self.inside_voxels = inside;
        self.undecided_voxels = undecided;
        let spacing = grid.spacing();
        let voxel = spacing.max_element();
        let warning = match thickness {
            // A trilinear field is negative on every plane of a sheet that is thicker than a voxel.
            Some(thickness) if thickness < voxel => Some(format!(
                "the sheet is {thickness:.2e} thick, thinner than the voxel of {voxel:.2e}: {inside} samples are inside, and \
                 it has holes where it passes between samples; a thickness of {:.2e} is held at every angle and offset",
                spacing.length()
            )),
            Some(_) if inside == 0 => Some("no sample is inside: the box does not hold the sheet".into()),
            None if inside == 0 => Some(self.nothing_inside(voxel)),
            None if self.sign_method != "unsigned" && !self.closed => {
                Some(opening_warning(self.boundary_edges, self.nonmanifold_edges))
            }
            _ => None,
        };
        self.warnings.extend(warning);
    }

    /// The reason why a field without a thickness has no inside.
    fn nothing_inside(&self, voxel: f64) -> String {
        let reason = if self.sign_method == "unsigned" {
            "unsigned distances have no inside; use two_sided=True for a sheet, or another sign for a solid".into()
        } else if self.closed {
            format!("the box does not hold the solid, or its thinnest part is below the voxel of {voxel:.2e}")
        } else {
            "the mesh is a sheet, or too thin for this resolution; use two_sided=True".into()
        };
        format!("no sample is inside: {reason}")
    }
}

/// Warnings about the sign of a surface that hold for all points; none for unsigned distances.
pub fn sign_warnings(mesh: &Mesh, method: SignMethod) -> Vec<String> {
    if method == SignMethod::Unsigned {
        return Vec::new();
    }
    let topology = mesh.topology();
    let mut warnings = orientation_warnings(mesh);
    if !topology.closed {
        warnings.push(opening_warning(topology.boundary_edges, topology.nonmanifold_edges));
    }
    warnings
}

fn orientation_warnings(mesh: &Mesh) -> Vec<String> {
    let topology = mesh.topology();
    let mut warnings = Vec::new();
    if topology.closed && topology.signed_volume(mesh) < 0.0 {
        warnings.push("the mesh is inside out; it was read as the same solid, right side out".into());
    }
    if topology.flipped_faces > 0 {
        let count = topology.flipped_faces;
        warnings.push(format!("{count} faces are wound against their neighbours; they were turned for the sign"));
    }
    if topology.unorientable_patches > 0 {
        let count = topology.unorientable_patches;
        warnings
            .push(format!("{count} patches cannot be oriented (one-sided surface); the sign there is a convention"));
    }
    warnings
}

/// The warning about a surface that is not closed. Without a boundary it is open where the faces at an edge do not
/// cancel: at edges of more than two faces, or in a patch that cannot be oriented.
fn opening_warning(boundary_edges: usize, nonmanifold_edges: usize) -> String {
    let open = match (boundary_edges, nonmanifold_edges) {
        (0, 0) => "it has no boundary, but its faces cannot be oriented alike".to_owned(),
        (0, count) => format!("it has no boundary, but {count} edges of more than two faces, which do not pair up"),
        (count, _) => format!("{count} boundary edges"),
    };
    format!("the surface is open ({open}): inside is where its winding number exceeds 1/2")
}
