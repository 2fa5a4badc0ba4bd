//! Packing on a device against the CPU, and the public WGSL text against its twin.

use super::entry::Facts;
use super::gpu::{DeviceItem, DevicePages};
use super::plan::plan;
use super::sample::AtlasField;
use super::shader::{ShaderOptions, Texels, wgsl};
use super::texels::{self, Item};
use super::{AtlasBlock, Layout};
use crate::encoding::Encoding;
use crate::gpu::Context;
use crate::gpu::tests::test_context;
use crate::grid::Grid;
use crate::progress::Progress;
use crate::volume::device::DeviceField;
use crate::volume::{SampleFilter, Trilinear};
use glam::{DMat4, DVec3, Vec3};
use std::sync::Arc;

/// Side of a page whose rows need padding in every encoding, texels.
const PAGE: u32 = 100;

/// Values of every magnitude: beyond the band, within it, tiny, subnormal, both zeros.
fn field(shape: [u32; 3], seed: u32) -> Vec<f32> {
    let special = [0.0, -0.0, 1e-40, -3e-6, 7e-8, 70_000.0, -1e9, 65_519.9, 0.5, 1.0, -1.0, 6.1e-5];
    (0..shape.iter().product::<u32>())
        .map(|i| {
            let random = (i.wrapping_mul(2_654_435_761).wrapping_add(seed * 977) >> 8) as f32 / (1 << 24) as f32;
            if i % 5 == 0 { special[(i / 5) as usize % special.len()] } else { 2.4 * random - 1.2 }
        })
        .collect()
}

struct Packed {
    blocks: Vec<AtlasBlock>,
    pages: u32,
    fields: Vec<Vec<f32>>,
    host: Vec<u8>,
}

/// The scale of an encoding in these tests; the scale of float16 must be a power of two.
fn scale(encoding: Encoding) -> f32 {
    encoding.scale(0.7, 0.7)
}

/// Values of one magnitude, for which the filter of a sampler is accurate.
fn moderate_field(shape: [u32; 3], seed: u32) -> Vec<f32> {
    field(shape, seed).into_iter().map(|value| value.clamp(-LARGEST, LARGEST)).collect()
}

/// Largest magnitude of [`moderate_field`].
const LARGEST: f32 = 1.2;

fn pack_on_host(
    encoding: Encoding,
    layout: Layout,
    shapes: &[[u32; 3]],
    field: impl Fn([u32; 3], u32) -> Vec<f32>,
) -> Packed {
    let align = 4 / encoding.bytes() as u32;
    let blocks = plan(layout, PAGE, align, &[], shapes).unwrap();
    let pages = 1 + blocks.iter().map(|block| block.page).max().unwrap();
    let fields: Vec<_> = shapes.iter().enumerate().map(|(i, &shape)| field(shape, i as u32)).collect();
    let items: Vec<_> = blocks
        .iter()
        .zip(&fields)
        .map(|(&block, distances)| Item { block, distances, scale: scale(encoding) })
        .collect();
    let mut words = vec![0u32; (pages * PAGE * PAGE) as usize * encoding.bytes() / 4];
    texels::write(bytemuck::cast_slice_mut(&mut words), PAGE, encoding, &items, &Progress::new()).unwrap();
    let host = bytemuck::cast_slice(&words).to_vec();
    Packed { blocks, pages, fields, host }
}

fn pack_on_device(context: &Arc<Context>, encoding: Encoding, packed: &Packed, max_bytes: u64) -> DevicePages {
    let fields: Vec<_> = packed
        .blocks
        .iter()
        .zip(&packed.fields)
        .map(|(block, samples)| {
            let shape = block.shape.map(|n| n as usize);
            let field = DeviceField::allocate(context, shape, max_bytes).unwrap();
            for slab in field.slabs() {
                let plane = shape[0] * shape[1];
                context
                    .fill("a field", &slab.buffer, &samples[plane * slab.first_plane..][..plane * slab.planes])
                    .unwrap();
            }
            field
        })
        .collect();
    let items: Vec<_> = packed
        .blocks
        .iter()
        .zip(&fields)
        .map(|(&block, field)| DeviceItem { block, field, scale: scale(encoding) })
        .collect();
    DevicePages::pack(context, PAGE, packed.pages, encoding, &items, &Progress::new()).unwrap()
}

const MIXED: [[u32; 3]; 5] = [[5, 4, 7], [13, 9, 2], [1, 1, 1], [6, 2, 23], [20, 20, 11]];

#[test]
fn the_device_packs_the_same_bytes() {
    let Some(context) = test_context() else { return };
    for encoding in Encoding::ALL {
        for (layout, shapes) in [(Layout::Shelves { gutter: 1 }, MIXED.as_slice()), (Layout::Strips, &[[7; 3]; 20])] {
            let packed = pack_on_host(encoding, layout, shapes, field);
            // Whole fields, and fields cut into slabs of a plane or two.
            for max_bytes in [u64::MAX, 700] {
                let device = pack_on_device(&context, encoding, &packed, max_bytes);
                assert!(device.read(&Progress::new()).unwrap() == packed.host, "{encoding:?} {layout:?} {max_bytes}");
            }
        }
    }
}

/// Entry point that evaluates the functions of the shader text at points.
const MAIN: &str = "
@group(0) @binding(2) var<storage, read> entries: array<AtlasEntry>;
@group(0) @binding(3) var<storage, read> points: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> values: array<vec4f>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&points) { return; }
    let entry = entries[u32(points[id.x].w)];
    let p = points[id.x].xyz;
    values[id.x] = vec4f(
        atlas_sample(entry, p), atlas_sample_filtered(entry, p), atlas_sample_nearest(entry, p),
        atlas_texture_coordinates(entry, p).y
    );
}";

#[test]
fn the_wgsl_samples_the_texture_as_the_cpu_samples_the_pages() {
    let Some(context) = test_context() else { return };
    for (layout, shapes) in [(Layout::Shelves { gutter: 1 }, MIXED.as_slice()), (Layout::Strips, &[[7; 3]; 20])] {
        for (encoding, texels) in [
            (Encoding::Float32, Texels::Pages),
            (Encoding::Float16, Texels::Pages),
            (Encoding::Snorm8, Texels::Pages),
            (Encoding::Snorm16, Texels::Png),
            (Encoding::Snorm8, Texels::Png),
            (Encoding::Snorm16, Texels::Integers),
            (Encoding::Snorm8, Texels::Integers),
        ] {
            let packed = pack_on_host(encoding, layout, shapes, moderate_field);
            let texture = match texels {
                Texels::Pages => pack_on_device(&context, encoding, &packed, u64::MAX).texture().unwrap(),
                Texels::Png => image_texture(&context, encoding, &packed),
                Texels::Integers => integer_texture(&context, encoding, &packed),
            };
            let box_of = |block: &AtlasBlock| {
                let shape = block.shape.map(|n| n as usize);
                Grid::new(DVec3::new(-1.0, 0.0, 0.5), DVec3::new(1.0, 2.0, 3.0), shape).unwrap()
            };
            let facts = packed.blocks.iter().map(|&block| {
                let grid = box_of(&block);
                let bounds = [grid.lower, grid.upper];
                let scale = encoding.is_scaled().then_some(scale(encoding));
                Facts { block, inner: bounds, outer: bounds, model: DMat4::IDENTITY, scale }
            });
            let entries: Vec<u8> = match layout {
                Layout::Strips => facts.flat_map(|f| bytemuck::bytes_of(&f.strip_entry()).to_vec()).collect(),
                Layout::Shelves { .. } => {
                    facts.flat_map(|f| bytemuck::bytes_of(&f.atlas_entry(PAGE)).to_vec()).collect()
                }
            };
            // Every entry at points all over its box, its corners and faces among them.
            let steps = [0.0, 0.04, 0.31, 0.5, 0.77, 1.0];
            let mut points = Vec::new();
            for entry in 0..shapes.len() {
                for (x, y, z) in steps.iter().flat_map(|x| steps.iter().flat_map(move |y| steps.map(|z| (*x, *y, z)))) {
                    let p = Vec3::new(-1.0 + 2.0 * x, 2.0 * y, 0.5 + 2.5 * z);
                    points.push(p.extend(entry as f32).to_array());
                }
            }
            let options = ShaderOptions { layout, encoding, texels, page_size: PAGE, side: shapes[0][0] };
            let has_filter = texels != Texels::Integers;
            let main = if has_filter { MAIN } else { &MAIN.replace("atlas_sample_filtered", "atlas_sample") };
            let values = run(&context, &(wgsl(&options) + main), &texture, has_filter, &entries, &points);

            for (entry, block) in packed.blocks.iter().enumerate() {
                let grid = box_of(block);
                let field = AtlasField::new(&packed.host, PAGE, encoding, scale(encoding), block, grid);
                let here: Vec<usize> = (0..points.len()).filter(|&i| points[i][3] == entry as f32).collect();
                let worlds: Vec<DVec3> = here.iter().map(|&i| Vec3::from_slice(&points[i]).as_dvec3()).collect();
                let expected =
                    field.sample(&worlds, [grid.lower, grid.upper], SampleFilter::Linear, &Progress::new()).unwrap();
                for (&i, (expected, world)) in here.iter().zip(expected.iter().zip(&worlds)) {
                    // Positions of up to 23 voxels are rounded in f32. The samples of this cell bound the slope.
                    let cell = field.clamp_to_box(field.grid_from_world(*world)).floor().as_ivec3();
                    let spread = corner_range(&packed.fields[entry], block, cell.to_array(), encoding);
                    let tolerance =
                        3.0 * spread * 24.0 * 4.0 * f32::EPSILON + 16.0 * f32::EPSILON * (spread + expected.abs());
                    // An unsigned integer over 65535 is rounded, multiplied and offset: three roundings of up to 2
                    // fractions.
                    let is_unsigned = texels == Texels::Png;
                    let tolerance = tolerance + if is_unsigned { 8.0 * f32::EPSILON * scale(encoding) } else { 0.0 };
                    let difference = (values[i][0] - expected).abs();
                    assert!(difference <= tolerance, "{encoding:?} {block:?} {world}: {difference} > {tolerance}");
                    // A hardware filter has 8 bits or more for each of its weights.
                    assert!((values[i][1] - expected).abs() <= 3.0 * 2.0 * LARGEST / 256.0);
                }
            }
        }
    }
}

/// The pages as a sampler returns the unsigned integers of an image file: 0 to 1, in a float texture, which every
/// device supports.
fn image_texture(context: &Context, encoding: Encoding, packed: &Packed) -> wgpu::Texture {
    let values: Vec<f32> = match encoding {
        Encoding::Snorm8 => packed.host.iter().map(|&bits| (i32::from(bits as i8) + 128) as f32 / 255.0).collect(),
        _ => bytemuck::cast_slice::<_, [u8; 2]>(&packed.host)
            .iter()
            .map(|&bits| (i32::from(i16::from_le_bytes(bits)) + 32768) as f32 / 65535.0)
            .collect(),
    };
    page_texture(context, wgpu::TextureFormat::R32Float, packed, bytemuck::cast_slice(&values))
}

/// The bytes of the pages as signed integers, in the formats that the core of WebGPU has.
fn integer_texture(context: &Context, encoding: Encoding, packed: &Packed) -> wgpu::Texture {
    let is_snorm8 = encoding == Encoding::Snorm8;
    let format = if is_snorm8 { wgpu::TextureFormat::R8Sint } else { wgpu::TextureFormat::R16Sint };
    assert_eq!(format.required_features(), wgpu::Features::empty());
    page_texture(context, format, packed, &packed.host)
}

fn page_texture(context: &Context, format: wgpu::TextureFormat, packed: &Packed, bytes: &[u8]) -> wgpu::Texture {
    let size = wgpu::Extent3d { width: PAGE, height: PAGE, depth_or_array_layers: packed.pages };
    let texture = context.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("pages of an atlas"),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let row_bytes = bytes.len() as u32 / (PAGE * packed.pages);
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes), rows_per_image: Some(PAGE) };
    context.queue.write_texture(texture.as_image_copy(), bytes, layout, size);
    texture
}

/// Largest change when rounding moves a point across a voxel border: the range of the samples of the cell and its
/// neighbours.
fn corner_range(samples: &[f32], block: &AtlasBlock, cell: [i32; 3], encoding: Encoding) -> f32 {
    let [nx, ny, nz] = block.shape.map(|n| n as i32);
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for z in cell[2] - 1..=cell[2] + 2 {
        for y in cell[1] - 1..=cell[1] + 2 {
            for x in cell[0] - 1..=cell[0] + 2 {
                let voxel = x.clamp(0, nx - 1) + nx * (y.clamp(0, ny - 1) + ny * z.clamp(0, nz - 1));
                let value = encoding.decode(encoding.encode(samples[voxel as usize], scale(encoding)), scale(encoding));
                (low, high) = (low.min(value), high.max(value));
            }
        }
    }
    high - low
}

/// Runs a compute shader on a texture, entries and points.
fn run(
    context: &Context,
    text: &str,
    texture: &wgpu::Texture,
    has_filter: bool,
    entries: &[u8],
    points: &[[f32; 4]],
) -> Vec<[f32; 4]> {
    let pipeline = context.compile("atlas sampling", "main", text).unwrap();
    let entries = context.upload("entries", entries).unwrap();
    let found = context.storage("values", size_of_val(points) as u64).unwrap();
    let points_buffer = context.upload("points", points).unwrap();
    let submission = context
        .guarded("atlas sampling", 0, || {
            let view = texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..Default::default()
            });
            let sampler = context.device.create_sampler(&wgpu::SamplerDescriptor {
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            });
            let resources = [
                wgpu::BindingResource::TextureView(&view),
                wgpu::BindingResource::Sampler(&sampler),
                entries.as_entire_binding(),
                points_buffer.as_entire_binding(),
                found.as_entire_binding(),
            ];
            let entries: Vec<_> = resources
                .into_iter()
                .enumerate()
                .filter(|(i, _)| has_filter || *i != 1)
                .map(|(i, resource)| wgpu::BindGroupEntry { binding: i as u32, resource })
                .collect();
            let group = context.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("atlas sampling"),
                layout: &pipeline.get_bind_group_layout(0),
                entries: &entries,
            });
            let mut encoder = context.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &group, &[]);
                pass.dispatch_workgroups((points.len() as u32).div_ceil(64), 1, 1);
            }
            context.queue.submit([encoder.finish()])
        })
        .unwrap();
    context.wait("atlas sampling", &submission, &Progress::new()).unwrap();
    let mut values = vec![[0f32; 4]; points.len()];
    context.read("values", &found, bytemuck::cast_slice_mut::<_, f32>(&mut values), &Progress::new()).unwrap();
    values
}
