//! Constants that a kernel and the Rust side of it share. Each is defined here and written into the WGSL text.
//!
//! A group has the name of a file in `shaders/` or `shaders/shared/`. [`super::shader`] puts the constants of the group
//! in front of the text of that file. In Rust, a group is a module: `csg_root::ERODED`. A constant has two types, since
//! an index is `usize` in Rust and `u32` in WGSL, and the CPU may use `f64` where a kernel uses `f32`.

use crate::encoding::{Encoding, HALF_SUBNORMAL as HALF_SUBNORMAL_STEP};
use std::fmt::Write;

macro_rules! wgsl_constants {
    ($($group:ident {
        $($(#[$doc:meta])* $name:ident: $rust:ty as $wgsl:ident = $value:expr;)*
    })*) => {
        $(pub(crate) mod $group {
            #[allow(unused_imports)]
            use super::*;
            $($(#[$doc])* pub(crate) const $name: $rust = $value;)*
        })*

        /// The declarations of a group in WGSL; empty for a file without shared constants.
        pub(crate) fn declarations(group: &str) -> String {
            let mut text = String::new();
            match group {
                $(stringify!($group) => {
                    // Writing to a string cannot fail.
                    $(let _ = writeln!(
                        text,
                        concat!("const ", stringify!($name), ": ", stringify!($wgsl), " = {};"),
                        $wgsl($group::$name as _),
                    );)*
                })*
                _ => {}
            }
            text
        }
    };
}

fn u32(value: u32) -> String {
    format!("{value}u")
}

fn i32(value: i32) -> String {
    format!("{value}i")
}

/// The shortest text that reads back as the same number.
fn f32(value: f32) -> String {
    format!("{value:?}f")
}

/// Larger than any squared distance in local coordinates. WGSL has no infinity.
const FAR_SQUARED: f32 = 3.0e38;

/// Capacity of the stack of a walk through a tree over boxes.
pub(crate) const BOX_STACK: usize = 56;

/// Largest number of lights of a picture.
pub(crate) const MAX_LIGHTS: usize = 16;

/// A direction component below this counts as parallel to the faces: over 2^40 voxels the ray moves by less than the
/// resolution of float32.
pub(crate) const PARALLEL_DIRECTION: f32 = 1e-20;

/// Larger than every `t` of a ray; replaces infinity.
pub(crate) const FAR_ALONG_RAY: f32 = 1e30;

/// Number of workgroups along x of kernels with one invocation for each sample.
const SAMPLE_GROUPS_PER_ROW: u64 = 32_768;

wgsl_constants! {
    bvh {
        /// Larger than any squared distance in local coordinates.
        FAR: f32 as f32 = FAR_SQUARED;
    }
    tree {
        /// Capacity of the stack of a search: each level of the eight-wide tree takes three entries, a pack one.
        MAX_STACK: usize as u32 = 96;
        /// Bit of a child that is a leaf.
        LEAF: u32 as u32 = 1 << 31;
        /// Unit of the number of triangles less one in a leaf.
        LEAF_ONE: u32 as u32 = 1 << 28;
        /// Mask of the first triangle of a leaf.
        LEAF_FIRST: u32 as u32 = LEAF_ONE - 1;
        /// Replaces a child that does not exist.
        NOTHING: u32 as u32 = u32::MAX;
    }
    cast_rays {
        /// Searches: for the first hit, for any hit, or for all hits.
        FIRST: u32 as u32 = 0;
        ANY: u32 as u32 = 1;
        ALL: u32 as u32 = 2;
        /// Limit of a ray that misses the box of the mesh and therefore hits no face.
        MISSED: f32 as f32 = -1.0;
        /// Limit of a ray that float32 does not represent. The CPU has to search it.
        UNSUITED: f32 as f32 = -2.0;
        /// Replaces the first face of a ray that the CPU has to search.
        UNDECIDED: u32 as u32 = u32::MAX - 1;
        /// Replaces the first face of a ray that certainly hits a face, in a search for any hit.
        CERTAIN: u32 as u32 = u32::MAX - 2;
        /// Margin of boxes, local units. The coordinates of a box and of a ray, of magnitude below 1, are rounded to
        /// 3e-8 each; two differences of them are rounded to 1.2e-7 each.
        BOX_MARGIN: f32 as f32 = 1e-6;
        /// Error of a sheared coordinate, local units. A vertex and the origin are rounded to 3e-8 each, their
        /// difference to 1.2e-7. The product with the direction doubles this and adds 1.5e-7; the last difference adds
        /// 2.4e-7. The product of two errors needs no term: up to a size of 2e-6 the slack exceeds every edge function,
        /// and above it the unused part of this constant covers the product.
        SHEAR_ROUNDING: f32 as f32 = 1e-6;
        /// Error of an edge function on a device, relative to the square of the largest sheared coordinate: a
        /// difference of two products. WGSL rounds a result to either neighbour, so four roundings are 1.2e-7 each.
        PRODUCT_ROUNDING: f32 as f32 = 5e-7;
        /// Error of a `t` beside the error of the edge functions, local units: 1.8e-7 of the coordinates, and fifteen
        /// roundings of values below 1.
        T_MARGIN: f32 as f32 = 4e-6;
        /// Larger than every `t`.
        FAR_T: f32 as f32 = FAR_ALONG_RAY;
    }
    bake_distance {
        /// Side of the block of samples that a workgroup evaluates.
        BLOCK: usize as u32 = 4;
    }
    bake_finish {
        /// Relative margin for the float32 rounding of stored squares.
        SLACK: f64 as f32 = 1e-5;
        WORKGROUPS_PER_ROW: u64 as u32 = SAMPLE_GROUPS_PER_ROW;
    }
    bake_brute {
        /// Largest number of triangles of a dispatch: a quarter of the loop iterations that software adapters allow.
        MAX_TRIANGLES: usize as u32 = 16_384;
        /// Sign rules. Any other number leaves the distance unsigned.
        NORMAL: u32 as u32 = 1;
        PARITY: u32 as u32 = 2;
        /// Article 001 nudges by 1e-4 in a scene of about unit size. Local coordinates are of about unit size too.
        NUDGE: f64 as f32 = 1e-4;
        WORKGROUPS_PER_ROW: u64 as u32 = SAMPLE_GROUPS_PER_ROW;
    }
    bricks {
        /// Number of cells along the side of a brick.
        BRICK_CELLS: usize as i32 = 7;
        /// Number of samples along the side of a brick.
        BRICK_SAMPLES: usize as u32 = BRICK_CELLS + 1;
        /// Number of samples of a brick.
        BRICK_LEN: usize as u32 = BRICK_SAMPLES * BRICK_SAMPLES * BRICK_SAMPLES;
        /// Lowest bit of the level in a word of the index.
        LEVEL_SHIFT: u32 as u32 = 30;
        /// Level of a brick without samples.
        NOTHING_STORED: u32 as u32 = 3;
        /// Mask of the stored brick in a word of the index.
        BRICK_MASK: u32 as u32 = (1 << LEVEL_SHIFT) - 1;
    }
    decode {
        FLOAT32: u32 as u32 = Encoding::Float32 as u32;
        FLOAT16: u32 as u32 = Encoding::Float16 as u32;
        SNORM16: u32 as u32 = Encoding::Snorm16 as u32;
        SNORM8: u32 as u32 = Encoding::Snorm8 as u32;
        /// Spacing of halves below 2^-14, which are evenly spaced.
        HALF_SUBNORMAL: f32 as f32 = HALF_SUBNORMAL_STEP;
    }
    merge_owners {
        /// Replaces the instance where the device could not identify it.
        UNDECIDED: u32 as u32 = u32::MAX;
        MAX_STACK: usize as u32 = BOX_STACK;
    }
    clip {
        FAR_T: f32 as f32 = FAR_ALONG_RAY;
    }
    cubic {
        /// Largest number of Newton steps. Every second step at least halves the bracket, and 24 halvings exhaust an
        /// f32.
        MAX_NEWTON_STEPS: u32 as u32 = 48;
        /// Newton's method stops at a step below this, in voxels: one ulp at 1, and less than an ulp of the ray
        /// parameter that the root is added to.
        SMALLEST_STEP: f32 as f32 = f32::EPSILON;
    }
    scene_occluders {
        /// The beams that an instance blocks: none, all, or cones only, if the CPU traces its triangles for rays.
        CASTS_NOTHING: u32 as u32 = 0;
        CASTS_FOR_ALL: u32 as u32 = 1;
        CASTS_FOR_CONES: u32 as u32 = 2;
    }
    scene_beams {
        /// Largest number of steps of one cone past one instance. Steps of at least half a voxel cross the diagonal of
        /// 128^3 in 450; few cones stay so near to a surface for so long.
        MAX_CONE_STEPS: u32 as u32 = 512;
        /// Number of directions around the axis of a blocked cone in which an edge is sought. A straight edge is at
        /// most 22.5 degrees away from one of them, so a ray at [`PAST_EDGE`] is at least 15 % of the depth beyond the
        /// edge.
        EDGE_DIRECTIONS: usize as u32 = 8;
        /// Cosine of half the angle between two of these directions.
        EDGE_COSINE: f32 as f32 = 0.923_879_5;
        /// Distance beyond an edge at which a ray must pass to prove the edge, in depths of the axis.
        PAST_EDGE: f32 as f32 = 1.25;
        /// Fraction of the clearance beyond a straight edge at which the edge counts completely. The rest covers the
        /// curvature of edges, and the rounding of distances in a field.
        FULL_CLEARANCE: f32 as f32 = 0.5;
    }
    scene_beam {
        /// Number of consecutive cones with a common cut of the scene's tree, and of nodes of a cut.
        CUT_BEAMS: u32 as u32 = 8;
        CUT_NODES: u32 as u32 = 16;
        /// Values of a beam's cut: its search starts at the root. In the second case it skips the beam's own instance.
        ROOT: u32 as u32 = u32::MAX;
        ROOT_WITHOUT_OWN: u32 as u32 = u32::MAX - 1;
        /// Value for no node in a cut.
        NO_NODE: u32 as u32 = u32::MAX;
    }
    scene_counts {
        /// Words of the counts of a light pass: cones, rays, discs that one cone did not decide, the first of these
        /// discs in a round, and cones of the round that need a ray past an edge. The numbers of beams and of discs
        /// that fit into their buffers follow.
        CONES: u32 as u32 = 0;
        RAYS: u32 as u32 = 1;
        DISCS: u32 as u32 = 2;
        FIRST_DISC: u32 as u32 = 3;
        EDGES: u32 as u32 = 4;
        BEAMS_FIT: u32 as u32 = 5;
        DISCS_FIT: u32 as u32 = 6;
        COUNTS: u32 as u32 = 8;
        /// Stages, each with its number of workgroups and its parameters.
        STAGE_TILES: u32 as u32 = 0;
        STAGE_CONES: u32 as u32 = 1;
        STAGE_RAYS: u32 as u32 = 2;
        STAGE_DISCS: u32 as u32 = 3;
        STAGE_PARTS: u32 as u32 = 4;
        STAGE_EDGES: u32 as u32 = 5;
        STAGE_CUTS: u32 as u32 = 6;
        STAGES: u32 as u32 = 7;
        /// Number of words from the parameters of a stage to the parameters of the next one: 256 bytes, the largest
        /// alignment of uniform buffers.
        STRIDE: u32 as u32 = 64;
        /// Number of invocations of a workgroup, and of the pixels of a tile.
        GROUP: u32 as u32 = 64;
        /// Side of a tile, pixels.
        TILE: u32 as u32 = 8;
        /// Number of tiles that follow each other and are spread evenly over the picture.
        SPREAD: u32 as u32 = 64;
        /// Number of cones that divide a light's disc if one is not sufficient.
        PARTS: u32 as u32 = 16;
    }
    light {
        MAX_LIGHTS: usize as u32 = super::MAX_LIGHTS;
    }
    csg_leaves {
        /// Parts of a divided cell of a baked volume along each axis.
        CELL_PARTS: usize as u32 = 4;
    }
    csg_tables {
        /// Lowest bit of the opcode of a token.
        TOKEN_SHIFT: u32 as u32 = 28;
        /// Flag of the token of a leaf in a part in closed form: the literal is the complement of the leaf.
        TOKEN_COMPLEMENTED: u32 as u32 = 1 << 26;
        /// Mask of the index of a token.
        TOKEN_INDEX: u32 as u32 = TOKEN_COMPLEMENTED - 1;
        /// Opcodes.
        TOKEN_LEAF: u32 as u32 = 0;
        TOKEN_UNION: u32 as u32 = 1;
        TOKEN_INTERSECTION: u32 as u32 = 2;
        TOKEN_DIFFERENCE: u32 as u32 = 3;
        TOKEN_XOR: u32 as u32 = 4;
        TOKEN_OFFSET: u32 as u32 = 5;
        TOKEN_SHELL: u32 as u32 = 6;
        TOKEN_COMPLEMENT: u32 as u32 = 7;
        TOKEN_ENTER: u32 as u32 = 8;
        TOKEN_LEAVE: u32 as u32 = 9;
        TOKEN_TIMES: u32 as u32 = 10;
    }
    csg_interpreter {
        /// Largest number of warps inside each other: a device keeps the position before each.
        MAX_WARPS: usize as u32 = 4;
    }
    csg_field {
        /// Larger than any distance in local units. As a result it means that an invocation ran out of rounds.
        CSG_FAR: f32 as f32 = FAR_SQUARED;
        /// Number of steps of Newton's method. In the worst places a step leaves at most 2/3 of the logarithm of the
        /// error, which is 1e3 there and weighs 1e-8; near the end a step squares the error.
        ELLIPSOID_STEPS: usize as u32 = 12;
        /// Smallest divisor. It is small beside all that is divided, and its inverse times a coordinate is finite.
        ELLIPSOID_TINY: f64 as f32 = 1e-20;
        /// Radius over the minor radius of a thread below which the field of the thread is a coarser bound.
        THREAD_CORE: f64 as f32 = 0.5;
        /// Number of searches for the nearest point of the profile of a thread.
        THREAD_SEARCHES: usize as u32 = 3;
    }
    csg_chord {
        /// Larger than the coordinate of any point of a ray through a model of size 1.
        CHORD_FAR: f32 as f32 = 1e30;
        /// A line with a smaller component of its unit direction across a slab is parallel to it. The inverse of a
        /// larger component is finite.
        CHORD_STILL: f32 as f32 = 1e-30;
        /// Square of the component of a unit direction across an axis below which the line is parallel to the axis.
        CHORD_PARALLEL: f32 as f32 = 1e-14;
    }
    csg_root {
        /// Depth in the solid that a ray must reach to hit it, local units (the model has size 1/2 to 1). A face is
        /// placed by up to eight float32 roundings of coordinates below 2, so two coincident faces are at most
        /// `2 * 8 * 2^-24 = 9.6e-7` apart.
        ERODED: f32 as f32 = 1e-6;
        /// Shortest step of a march, local units: a hundred roundings of the field. A ray that is inside a sphere of
        /// the model's size for less than this goes 1e-9 deep.
        MIN_STEP: f32 as f32 = 3e-5;
        /// Largest number of steps in one box. Only a ray that stays closer to a surface than the shortest step needs
        /// more.
        MAX_MARCH_STEPS: u32 as u32 = 4096;
        /// Largest number of steps of regula falsi, which needs a fraction of them.
        MAX_ROOT_STEPS: u32 as u32 = 32;
        /// A bracket of this width is a root: one ulp of a position near 1.
        ROOT_WIDTH: f32 as f32 = 1.2e-7;
    }
    csg_draw {
        /// Distance of the start of a shadow ray from the surface, local units: about thirty of the shortest steps.
        SHADOW_BIAS: f32 as f32 = 1e-3;
        /// Larger than the `t` at which a ray of a picture leaves the model. A ray at a grazing angle to the image
        /// plane has a long way between the plane where it starts and the model.
        FAR_T: f32 as f32 = 1e6;
        /// Replaces a smaller component of a direction, so that its inverse is finite.
        STILL: f32 as f32 = 1e-30;
        MAX_LIGHTS: usize as u32 = super::MAX_LIGHTS;
        /// Kinds of parts. A part with a larger number has a function of its own.
        FORM_FIELD: u32 as u32 = 0;
        FORM_UNION: u32 as u32 = 1;
        FORM_CHORDS: u32 as u32 = 2;
        /// Results of a pixel.
        PIXEL_HIT: u32 as u32 = 1;
        PIXEL_RAN_OUT: u32 as u32 = 2;
    }
}
