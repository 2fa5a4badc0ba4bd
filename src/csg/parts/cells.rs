//! Parts prepared for rays: their boxes in local units, a tree over the boxes, and the form in which each part is
//! intersected.

use super::chord;
use super::chord::{PartKind, Step};
use super::part::Part;
use crate::bvh::boxes::BoxTree;
use crate::csg::evaluation::program::{LocalFrame, Program};
use crate::csg::model::lowered::Model;
use crate::csg::model::token::Token;
use glam::{Vec3, Vec3A};
use std::sync::Arc;

/// A part's box extends this far beyond the extent of its tree, local units: some roundings of a coordinate.
const BOX_PAD: f64 = 1e-6;

/// The tables of a solid that its parts share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SharedTables<'a> {
    pub model: &'a Model,
    pub frame: LocalFrame,
    pub program: &'a Program<f32>,
}

/// A part's box in local units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalBox {
    pub lower: Vec3A,
    pub upper: Vec3A,
    pub part: u32,
}

/// A node of the tree over boxes. An inner node (`count` 0) has the children `first` and `first + 1`; a leaf has
/// `count` boxes from `first`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CellNode {
    pub lower: Vec3A,
    pub upper: Vec3A,
    pub first: u32,
    pub count: u32,
}

/// The tree of a part, prepared for rays.
#[derive(Debug)]
pub(crate) struct PartProgram {
    pub tokens: Arc<[Token]>,
    pub form: PartKind,
    /// Normal form of a part in closed form; empty for a sphere-traced part.
    pub steps: Box<[Step]>,
    /// Number of leaf evaluations in one evaluation of the part.
    pub leaves: u32,
    pub inverse_lipschitz: f32,
}

impl PartProgram {
    pub(crate) fn new(solid: SharedTables<'_>, tokens: &Arc<[Token]>) -> Self {
        let form = PartKind::of(solid.program, tokens);
        let steps =
            if form == PartKind::Field { None } else { chord::steps(solid.program, tokens) }.unwrap_or_default();
        let leaves = if steps.is_empty() { Model::leaf_count(tokens) } else { steps.len().div_ceil(2) };
        Self {
            form,
            steps: steps.into_boxed_slice(),
            leaves: leaves as u32,
            inverse_lipschitz: (1.0 / solid.model.lipschitz_of(tokens)) as f32,
            tokens: tokens.clone(),
        }
    }
}

/// Parts prepared for rays, the tables of a tracer.
#[derive(Debug, Clone)]
pub(crate) struct PartCells {
    pub programs: Arc<[PartProgram]>,
    pub boxes: Arc<[LocalBox]>,
    pub nodes: Arc<[CellNode]>,
    /// Lower and upper corner of all boxes.
    pub bounds: [Vec3; 2],
}

impl PartCells {
    /// Prepares the parts of a solid, whose boxes are in world units. Each box is cut to the extent of its part's tree.
    pub(crate) fn new(solid: SharedTables<'_>, parts: &[Part]) -> Self {
        let programs: Arc<[PartProgram]> = parts.iter().map(|part| PartProgram::new(solid, &part.tokens)).collect();
        let mut boxes: Vec<LocalBox> = Vec::new();
        for (i, part) in parts.iter().enumerate() {
            let filled = solid.model.extent_of(&part.tokens);
            let (low, high) = (solid.frame.local(filled.lower) - BOX_PAD, solid.frame.local(filled.upper) + BOX_PAD);
            boxes.extend(part.boxes.iter().map(|&[lower, upper]| LocalBox {
                lower: solid.frame.local(lower).max(low).as_vec3a(),
                upper: solid.frame.local(upper).min(high).as_vec3a(),
                part: i as u32,
            }));
        }
        boxes.retain(|cell| cell.lower.cmplt(cell.upper).all());

        let corners = |cell: &LocalBox| [cell.lower.as_dvec3(), cell.upper.as_dvec3()];
        let tree = BoxTree::new(&boxes.iter().map(corners).collect::<Vec<_>>());
        // The tree stores corners relative to its centre, which rounds them.
        let place = |corner: Vec3| (corner.as_dvec3() + tree.center).as_vec3a();
        let nodes: Arc<[CellNode]> = tree
            .nodes
            .iter()
            .map(|node| CellNode {
                lower: place(node.min) - BOX_PAD as f32,
                upper: place(node.max) + BOX_PAD as f32,
                first: node.first,
                count: node.count,
            })
            .collect();
        let boxes = tree.order.iter().map(|&i| boxes[i as usize]).collect();
        let bounds = nodes.first().map_or([Vec3::ZERO; 2], |root| [root.lower.into(), root.upper.into()]);
        Self { programs, boxes, nodes, bounds }
    }
}
