//! Shapes on a graphics device: the interpreter of `shaders/shared/csg/csg_interpreter.wgsl` for points, grids and
//! pictures.
//!
//! One kernel evaluates every shape. Tokens, tables and boxes are buffers, so a changed parameter or a changed tree
//! compiles nothing. Pictures switch to a specialised kernel for the shape's structures and kinds of leaves
//! ([`crate::csg::text::specialised_kernel`]) as soon as a background thread has compiled it.
//!
//! A compute kernel traces rays through the boxes of the parts, one invocation per pixel. It returns the hit of each
//! ray and the lights that reach it. The CPU computes colours from these with the function of its own pictures. An
//! invocation that runs out of rounds (software adapters stop at 65,535) sets a flag, and the CPU repeats its point or
//! pixel.
//!
//! Alternative tried: rasterising the boxes front to back, with a root search and a depth per fragment. It gives the
//! same picture and is slower with many boxes (`benches/results/2026-11-21-csg.md`). The compute kernel visits nothing
//! behind the first hit, and shadow rays need it anyway.

use super::picture::{Drawing, PixelScratch, ShapeView, VisiblePoint};
use crate::csg::evaluation::leaf::{Flat, LeafField, PlacedLeaf, kernel_texts};
use crate::csg::evaluation::program::{Joint, PlacedDistanceOp, PlacedWarpKind, Program};
use crate::csg::model::token::Token;
use crate::csg::parts::cells::PartProgram;
use crate::csg::parts::chord::{PartKind, Step};
use crate::csg::parts::solid::Solid;
use crate::csg::parts::trace::Tracer;
use crate::csg::text::specialised_kernel::{Entry, SpecialisedKernel};
use crate::csg::tree::kind::Op;
use crate::csg::tree::placement::by_number;
use crate::error::{DeviceError, Error};
use crate::gpu::constants::csg_draw::{PIXEL_HIT, PIXEL_RAN_OUT};
use crate::gpu::constants::csg_field::CSG_FAR;
use crate::gpu::constants::csg_tables::*;
use crate::gpu::layout::{CsgBox, CsgDrawParams, CsgLeaf, CsgPixel, CsgPointParams};
use crate::gpu::pace::{in_groups, in_pieces};
use crate::gpu::shader::source_with;
use crate::gpu::{Context, Place};
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::picture::Frame;
use crate::progress::Progress;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Side of a workgroup of `csg_draw` in pixels, as in the shader.
const TILE: u32 = 8;
/// Number of rows of workgroups of `csg_draw` in the first dispatch, and largest number in any.
const TILE_ROWS: (u64, u64) = (1, 1024);
/// Number of points in device memory at a time.
const BATCH: usize = 1 << 20;

/// Tables in device memory.
struct ShapeBuffers {
    tokens: wgpu::Buffer,
    leaves: wgpu::Buffer,
    numbers: wgpu::Buffer,
}

/// Encodes tables in the layout of the shader.
struct Encoder<'a> {
    program: &'a Program<f32>,
    leaves: Vec<CsgLeaf>,
    numbers: Vec<f32>,
    first_joint: u32,
    first_level: u32,
    first_warp: u32,
}

impl<'a> Encoder<'a> {
    fn new(program: &'a Program<f32>) -> Self {
        let mut numbers = Vec::new();
        let first_joint = 0;
        for combine in &program.combines {
            let (kind, width) = match combine.joint {
                Joint::Sharp => (0.0, 0.0),
                Joint::Smooth(k, _) => (1.0, k),
                Joint::Chamfer(k) => (2.0, k),
            };
            numbers.extend([kind, width, f32::from(u8::from(combine.is_swapped))]);
        }
        let first_level = numbers.len() as u32;
        numbers.extend(program.levels.iter().map(|level| match *level {
            PlacedDistanceOp::Offset(distance) => distance,
            PlacedDistanceOp::Shell(half) => half,
            PlacedDistanceOp::Times(factor) => factor,
        }));
        let mut leaves: Vec<CsgLeaf> = program.leaves.iter().map(|leaf| encoded(leaf, &mut numbers)).collect();
        let first_warp = leaves.len() as u32;
        leaves.extend(program.warps.iter().map(|warp| {
            let (kind, a) = match warp.kind {
                PlacedWarpKind::Elongate([x, y, z]) => (0, [x, y, z, 0.0]),
                PlacedWarpKind::Twist(rate) => (1, [rate, 0.0, 0.0, 0.0]),
                PlacedWarpKind::Bend(rate) => (2, [rate, 0.0, 0.0, 0.0]),
                PlacedWarpKind::NearestCopy(_) => (3, [0.0; 4]),
            };
            let first = numbers.len() as u32;
            if let PlacedWarpKind::NearestCopy(axes) = warp.kind {
                numbers.extend(by_number(&axes).into_iter().flatten());
            }
            CsgLeaf { a, b: [warp.rate, warp.radius], kind, first, ..placed(&warp.rows, warp.shift) }
        }));
        Self { program, leaves, numbers, first_joint, first_level, first_warp }
    }

    fn token(&self, token: Token) -> u32 {
        let (what, index) = match token {
            Token::Leaf(leaf) => (TOKEN_LEAF, leaf),
            Token::Combine(i) => {
                let what = match self.program.combines[i as usize].op {
                    Op::Union => TOKEN_UNION,
                    Op::Intersection => TOKEN_INTERSECTION,
                    Op::Difference => TOKEN_DIFFERENCE,
                    Op::Xor => TOKEN_XOR,
                };
                (what, self.first_joint + 3 * i)
            }
            Token::DistanceOp(i) => {
                let what = match self.program.levels[i as usize] {
                    PlacedDistanceOp::Offset(_) => TOKEN_OFFSET,
                    PlacedDistanceOp::Shell(_) => TOKEN_SHELL,
                    PlacedDistanceOp::Times(_) => TOKEN_TIMES,
                };
                (what, self.first_level + i)
            }
            Token::Complement => (TOKEN_COMPLEMENT, 0),
            Token::Enter(i) => (TOKEN_ENTER, self.first_warp + i),
            Token::Leave(i) => (TOKEN_LEAVE, self.first_warp + i),
        };
        what << TOKEN_SHIFT | index
    }

    /// The tokens of a sphere-traced part, or the normal form of a part in closed form.
    fn part(&self, part: &PartProgram) -> Vec<u32> {
        if part.form == PartKind::Field {
            return part.tokens.iter().map(|&token| self.token(token)).collect();
        }
        let encoded = |step: &Step| match *step {
            Step::Literal { leaf, is_complement: false } => leaf,
            Step::Literal { leaf, is_complement: true } => leaf | TOKEN_COMPLEMENTED,
            Step::Union => TOKEN_UNION << TOKEN_SHIFT,
            Step::Intersection => TOKEN_INTERSECTION << TOKEN_SHIFT,
        };
        part.steps.iter().map(encoded).collect()
    }

    fn upload(&self, context: &Context, tokens: &[u32]) -> Result<ShapeBuffers, Error> {
        Ok(ShapeBuffers {
            tokens: context.upload("tokens of a shape", tokens)?,
            leaves: context.upload("leaves of a shape", &self.leaves)?,
            numbers: context.upload("numbers of a shape", &self.numbers)?,
        })
    }
}

fn placed(rows: &[[f32; 3]; 3], [shift_x, shift_y, shift_z]: [f32; 3]) -> CsgLeaf {
    let [row_x, row_y, row_z] = *rows;
    CsgLeaf { row_x, shift_x, row_y, shift_y, row_z, shift_z, ..CsgLeaf::default() }
}

fn encoded(leaf: &PlacedLeaf<f32>, numbers: &mut Vec<f32>) -> CsgLeaf {
    let first = numbers.len() as u32;
    match &leaf.field {
        LeafField::Extrude(flat) | LeafField::Revolve(flat) => match flat {
            Flat::Circle(radius) => numbers.push(*radius),
            Flat::Rectangle(half) => numbers.extend(half),
            Flat::Polygon(polygon) => numbers.extend(polygon.numbers()),
        },
        LeafField::Volume(volume, placed) => {
            numbers.extend(placed.lower.iter().chain(&placed.upper).chain(&placed.inverse_spacing));
            numbers.extend(placed.shape.map(|n| n as f32));
            let divided = volume.divided();
            // A buffer has at most 2^30 numbers, so fewer than 2^24 blocks. Their numbers are exact in f32.
            numbers.extend([placed.scale, if divided.blocks().is_empty() { 0.0 } else { 1.0 }]);
            numbers.extend(volume.distances());
            numbers.extend(divided.blocks().iter().map(|block| *block as f32));
            numbers.extend(divided.samples());
        }
        _ => {}
    }
    let [a0, a1, a2, a3, b0, b1] = leaf.parameters;
    CsgLeaf { a: [a0, a1, a2, a3], b: [b0, b1], kind: leaf.field.kind(), first, ..placed(&leaf.rows, leaf.shift) }
}

impl Solid {
    /// [`Self::distances`] at a place.
    pub fn distances_at(&self, place: &Place, points: &[DVec3], progress: &Progress) -> Result<Vec<f32>, Error> {
        match place {
            Place::Cpu => self.distances(points, progress),
            Place::Gpu(context) => distances(self, context, points, progress),
        }
    }

    /// [`Self::bake`] at a place.
    pub fn bake_at(&self, place: &Place, grid: &Grid, progress: &Progress) -> Result<Vec<f32>, Error> {
        match place {
            Place::Cpu => self.bake(grid, progress),
            Place::Gpu(context) => bake(self, context, grid, progress),
        }
    }
}

/// Signed distances at world points, in float32.
fn distances(solid: &Solid, context: &Context, points: &[DVec3], progress: &Progress) -> Result<Vec<f32>, Error> {
    progress.set_total(points.len() as u64);
    let mut out = vec![0.0f32; points.len()];
    if points.is_empty() {
        return Ok(out);
    }
    let encoder = Encoder::new(&solid.program);
    let tokens: Vec<u32> = solid.model.tokens.iter().map(|&token| encoder.token(token)).collect();
    let tables = encoder.upload(context, &tokens)?;
    let kernel = interpreter(context, "csg_points")?;
    for (points, out) in points.chunks(BATCH).zip(out.chunks_mut(BATCH)) {
        let local: Vec<f32> = points.iter().flat_map(|&p| solid.frame.local(p).as_vec3().to_array()).collect();
        let positions = context.upload("points", &local)?;
        let found = context.storage("distances", size_of_val(out) as u64)?;
        let mut params = CsgPointParams { token_count: tokens.len() as u32, ..CsgPointParams::default() };
        let uniform = context.uniform("point parameters", &params)?;
        let buffers = [
            (0, &uniform),
            (1, &tables.tokens),
            (2, &tables.leaves),
            (3, &tables.numbers),
            (4, &positions),
            (5, &found),
        ];
        let group = context.bind("points of a shape", &kernel, &buffers)?;
        in_groups(context, "the shape kernel", points.len(), progress, |first, count, workgroups| {
            (params.first, params.count) = (first, count);
            context.write("point parameters", &uniform, 0, &[params])?;
            progress.advance(count.into())?;
            Ok(context.dispatch("points of a shape", &kernel, &group, workgroups)?)
        })?;
        context.read("distances", &found, out, progress)?;
        // The CPU evaluates the points that ran out of rounds.
        let late: Vec<usize> = (0..out.len()).filter(|&i| out[i] >= CSG_FAR).collect();
        let redone = solid.distances(&late.iter().map(|&i| points[i]).collect::<Vec<_>>(), &Progress::new())?;
        let scale = solid.frame.scale;
        out.iter_mut().for_each(|d| *d = (f64::from(*d) * scale) as f32);
        late.into_iter().zip(redone).for_each(|(i, distance)| out[i] = distance);
    }
    Ok(out)
}

/// Samples at the voxel centres of a grid, x fastest.
fn bake(solid: &Solid, context: &Context, grid: &Grid, progress: &Progress) -> Result<Vec<f32>, Error> {
    let [nx, ny, nz] = grid.shape;
    let what = format!("a field of {nx} x {ny} x {nz} samples");
    let mut samples = allocate_samples(&what, grid.len(), 0)?;
    // Number of whole planes of points at a time.
    let planes = (BATCH / (nx * ny)).max(1);
    for (slab, out) in samples.chunks_mut(nx * ny * planes).enumerate() {
        let first = slab * planes;
        let points: Vec<DVec3> =
            (0..out.len()).map(|i| grid.center(i % nx, i / nx % ny, first + i / (nx * ny))).collect();
        let inner = Progress::new();
        progress.check()?;
        out.copy_from_slice(&distances(solid, context, &points, &inner)?);
    }
    Ok(samples)
}

/// Draws on a device.
pub(crate) fn draw(view: &ShapeView<'_>, context: &Arc<Context>, progress: &Progress) -> Result<Drawing, Error> {
    let (tracer, options) = (view.tracer, view.options);
    let [width, height] = options.size;
    let pixel_count = width as usize * height as usize;
    let solid = tracer.solid;
    let mut encoder = Encoder::new(&solid.program);
    let compiled = SpecialisedKernel::of(tracer, &mut encoder.numbers);
    let structures = compiled.structures;
    let written = written_kernel(context, &compiled)?;
    let (boxes, tokens) = encoded_boxes(tracer, &encoder, &compiled.entries);
    let tables = encoder.upload(context, &tokens)?;
    let mut params = params(view);
    let lights: Vec<[f32; 4]> =
        view.lights.iter().map(|light| [light.direction.x, light.direction.y, light.direction.z, 0.0]).collect();
    let uniform = context.parameters("picture parameters", &params)?;
    let box_buffer = context.upload("boxes of a shape", &boxes)?;
    let light_buffer = context.upload("lights", &lights)?;
    let pixels = context.storage("a picture", (pixel_count * size_of::<CsgPixel>()) as u64)?;
    let shares = context.storage("light shares", (4 * pixel_count * lights.len().max(1)) as u64)?;
    let kernel = match written.clone() {
        Some(kernel) => kernel,
        None => interpreter(context, "csg_draw")?,
    };
    let buffers = [
        (0, &uniform),
        (1, &tables.tokens),
        (2, &tables.leaves),
        (3, &tables.numbers),
        (4, &box_buffer),
        (5, &light_buffer),
        (6, &pixels),
        (7, &shares),
    ];
    let group = context.bind("picture of a shape", &kernel, &buffers)?;
    progress.set_total(u64::from(height));
    let rows = u64::from(height.div_ceil(TILE));
    in_pieces(context, "the shape kernel", rows, TILE_ROWS.0, TILE_ROWS.1, progress, |first, count| {
        params.rays.first_row = first as u32 * TILE;
        context.write("picture parameters", &uniform, 0, &[params])?;
        progress.advance((count * u64::from(TILE)).min(u64::from(height - params.rays.first_row)))?;
        Ok(context.dispatch("picture of a shape", &kernel, &group, [width.div_ceil(TILE), count as u32, 1])?)
    })?;

    let mut found = vec![CsgPixel::default(); pixel_count];
    context.read("a picture", &pixels, &mut found, progress)?;
    let mut frame = Frame::new(width as usize, height as usize, lights.len())?;
    context.read("light shares", &shares, &mut frame.shadow, progress)?;
    light_pixels(view, &found, &mut frame, progress)?;
    Ok(Drawing {
        frame,
        parts: tracer.programs.len(),
        boxes: tracer.boxes.len(),
        leaf_evaluations: found.iter().map(|pixel| u64::from(pixel.tokens)).sum(),
        structures,
        is_compiled: written.is_some(),
        pipelines: 1 + context.written_kernel_count(),
    })
}

/// Fills a frame from the pixels that a device found. The frame has the fractions of the lights that arrive already.
fn light_pixels(view: &ShapeView<'_>, found: &[CsgPixel], frame: &mut Frame, progress: &Progress) -> Result<(), Error> {
    let width = view.options.size[0] as usize;
    frame.rows().into_par_iter().enumerate().try_for_each_init(PixelScratch::default, |scratch, (y, mut row)| {
        row.color.as_chunks_mut().0.fill(view.options.background);
        for x in 0..width {
            let pixel = &found[y * width + x];
            if pixel.state == PIXEL_RAN_OUT {
                row.shadow[x * row.lights..][..row.lights].fill(1.0);
                view.draw_pixel(x, y, &mut row, scratch);
                continue;
            }
            row.steps[x] = pixel.steps;
            if pixel.state == PIXEL_HIT {
                let ray = view.rays.through(x, y);
                let hit = VisiblePoint {
                    p: ray.origin + pixel.t * ray.direction,
                    depth: view.rays.depth(&ray, pixel.t),
                    normal: Vec3::from_array(pixel.normal),
                    part: Some(view.tracer.boxes[pixel.cell as usize].part),
                };
                let shadow: Vec<f32> = row.shadow[x * row.lights..][..row.lights].to_vec();
                let mut shares = shadow.into_iter();
                view.finish(x, &mut row, &hit, ray.direction, |_| shares.next().unwrap_or(1.0));
            }
        }
        progress.check()
    })
}

/// A kernel that evaluates all kinds of leaves.
fn interpreter(context: &Context, name: &'static str) -> Result<wgpu::ComputePipeline, DeviceError> {
    context.kernel_with(name, "main", &kernel_texts())
}

/// The kernel specialised for a shape, if it is compiled.
fn written_kernel(
    context: &Arc<Context>,
    compiled: &SpecialisedKernel,
) -> Result<Option<wgpu::ComputePipeline>, DeviceError> {
    let refused = |reason| DeviceError::Shader { device: context.label(), kernel: "csg_draw".into(), reason };
    let texts: Vec<_> = compiled.texts.iter().map(|(name, text)| (*name, text.as_str())).collect();
    let source = source_with("csg_draw", &texts).map_err(refused)?;
    Ok(context.written_kernel("csg_draw", "main", source))
}

/// The nodes of the tree followed by the boxes, and the concatenated tokens of all parts.
fn encoded_boxes(tracer: &Tracer<'_>, encoder: &Encoder<'_>, entries: &[Entry]) -> (Vec<CsgBox>, Vec<u32>) {
    let mut tokens = Vec::new();
    let mut ranges = Vec::new();
    for program in tracer.programs.iter() {
        let part = encoder.part(program);
        ranges.push((tokens.len() as u32, part.len() as u32));
        tokens.extend(part);
    }
    let nodes = tracer.nodes.iter().map(|node| CsgBox {
        lower: node.lower.to_array(),
        first: node.first,
        upper: node.upper.to_array(),
        count: node.count,
        ..CsgBox::default()
    });
    let boxes = tracer.boxes.iter().map(|cell| CsgBox {
        lower: cell.lower.to_array(),
        first: ranges[cell.part as usize].0,
        upper: cell.upper.to_array(),
        count: ranges[cell.part as usize].1,
        form: entries[cell.part as usize].form,
        parameters: entries[cell.part as usize].parameters,
        ..CsgBox::default()
    });
    (nodes.chain(boxes).collect(), tokens)
}

fn params(view: &ShapeView<'_>) -> CsgDrawParams {
    let tracer = view.tracer;
    CsgDrawParams {
        rays: view.rays.rays,
        inverse_lipschitz: tracer.programs.iter().map(|part| part.inverse_lipschitz).fold(1.0, f32::min),
        node_count: tracer.nodes.len() as u32,
        ..CsgDrawParams::default()
    }
}
