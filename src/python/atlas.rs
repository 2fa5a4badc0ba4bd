//! `fieldbake._core.atlas_*`: planning, packing and reading atlases.
//!
//! A block is passed as a row of ten u32, the fields of [`AtlasBlock`] in order. Pages are passed as bytes of the shape
//! (pages, size, size * bytes of a texel).

use super::convert::{points, samples, volume_array};
use super::device::{DeviceField, choose};
use super::error::{Failure, exception};
use super::run::{run, run_short};
use crate::atlas::entry::{AtlasEntry, Facts, StripEntry};
use crate::atlas::sample::{AtlasField, texture_coordinates};
use crate::atlas::shader::{ShaderOptions, Texels, shader};
use crate::atlas::texels::{self, Item};
use crate::atlas::{AtlasBlock, Layout, gpu, plan};
use crate::encoding::Encoding;
use crate::gpu::Place;
use crate::grid::Grid;
use crate::memory;
use crate::shader_text::translation::Language;
use crate::volume::{SampleFilter, Trilinear, device};
use glam::{DMat4, DVec3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::sync::Arc;

type Blocks<'py> = PyReadonlyArray2<'py, u32>;

/// Number of values in a row of blocks.
const BLOCK_NUMBERS: usize = size_of::<AtlasBlock>() / size_of::<u32>();
/// Page of a row without a field.
const VACANT: u32 = u32::MAX;

/// Plans blocks (n, 10) for fields of the shapes (n, 3), beside the occupied blocks.
#[pyfunction]
#[pyo3(signature = (shapes, taken, *, layout, page_size, gutter, encoding))]
pub(super) fn atlas_plan<'py>(
    py: Python<'py>,
    shapes: PyReadonlyArray2<'py, u32>,
    taken: Blocks<'py>,
    layout: &str,
    page_size: u32,
    gutter: u32,
    encoding: &str,
) -> PyResult<Bound<'py, PyArray2<u32>>> {
    let shapes = super::convert::rows(&shapes, "shapes")?;
    let taken: Vec<AtlasBlock> = blocks(&taken)?.iter().filter(|block| block.page != VACANT).copied().collect();
    let layout = Layout::from_name(layout, gutter).map_err(Failure::from)?;
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let placed = run_short(py, || plan::plan(layout, page_size, align(encoding), &taken, shapes))?;
    let numbers: Vec<u32> = bytemuck::cast_slice(&placed).to_vec();
    numbers.into_pyarray(py).reshape([placed.len(), BLOCK_NUMBERS])
}

/// Alignment of blocks in texels: a device writes whole words.
fn align(encoding: Encoding) -> u32 {
    (size_of::<u32>() / encoding.bytes()) as u32
}

/// Whether each block is safe to read.
#[pyfunction]
pub(super) fn atlas_sound(blocks: Blocks<'_>, page_size: u32, pages: u32) -> PyResult<Vec<bool>> {
    Ok(self::blocks(&blocks)?.iter().map(|block| block.page == VACANT || block.is_sound(page_size, pages)).collect())
}

/// Fills the blocks of fields.
#[pyfunction]
#[pyo3(signature = (pages, blocks, volumes, scales, *, encoding, progress=None))]
pub(super) fn atlas_write<'py>(
    py: Python<'py>,
    mut pages: PyReadwriteArray3<'py, u8>,
    blocks: Blocks<'py>,
    volumes: Vec<PyReadonlyArray3<'py, f32>>,
    scales: Vec<f32>,
    encoding: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<()> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let page_size = check_pages(py, pages.shape(), encoding, self::blocks(&blocks)?)?;
    let blocks = self::blocks(&blocks)?;
    let items: Vec<Item<'_>> = blocks
        .iter()
        .zip(&volumes)
        .zip(scales)
        .map(|((&block, volume), scale)| {
            let distances = volume.as_slice().ok().filter(|samples| samples.len() == block.voxels());
            let distances = distances.filter(|_| volume.is_fortran_contiguous());
            let distances = distances.ok_or_else(|| broken(py, "volumes must fit their blocks, x fastest"))?;
            Ok(Item { block, distances, scale })
        })
        .collect::<PyResult<_>>()?;
    let texels = pages.as_slice_mut()?;
    run(py, progress, |progress| texels::write(texels, page_size, encoding, &items, progress))?;
    Ok(())
}

/// Pages in the memory of a graphics device, read back on request.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct DevicePages {
    pages: gpu::DevicePages,
    count: u32,
}

#[pymethods]
impl DevicePages {
    /// Number of pages.
    fn __len__(&self) -> usize {
        self.count as usize
    }

    #[getter]
    fn device(&self) -> String {
        self.pages.context().label()
    }

    /// The texels of all pages as bytes.
    fn read<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<u8>>> {
        Ok(run(py, None, |progress| self.pages.read(progress))?.into_pyarray(py))
    }
}

/// A field that a device can read, or one to upload.
#[derive(FromPyObject)]
pub(super) enum Source<'py> {
    Device(PyRef<'py, DeviceField>),
    Host(PyReadonlyArray3<'py, f32>),
}

/// Fills new pages on a device; `None` if `device` is the CPU.
#[pyfunction]
#[pyo3(signature = (blocks, volumes, scales, *, page_size, pages, encoding, device, progress=None))]
pub(super) fn atlas_pack_device<'py>(
    py: Python<'py>,
    blocks: Blocks<'py>,
    volumes: Vec<Source<'py>>,
    scales: Vec<f32>,
    page_size: u32,
    pages: u32,
    encoding: &str,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Option<DevicePages>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let Place::Gpu(context) = choose(py, device)? else { return Ok(None) };
    let blocks = self::blocks(&blocks)?;
    let fits = blocks.iter().all(|block| block.is_sound(page_size, pages)) && page_size <= plan::MAX_PAGE_SIZE;
    if !fits || blocks.len() != volumes.len() || blocks.len() != scales.len() {
        return Err(broken(py, "a block does not lie on the pages"));
    }
    let fields: Vec<device::DeviceField> = volumes
        .iter()
        .map(|volume| match volume {
            Source::Device(field) if Arc::ptr_eq(field.0.context(), &context) => Ok(field.0.clone()),
            Source::Device(_) => Err(broken(py, "a field lies on another device")),
            Source::Host(array) => {
                let (shape, samples) = samples(array)?;
                Ok(run(py, None, |_| device::DeviceField::upload(&context, shape, samples))?)
            }
        })
        .collect::<PyResult<_>>()?;
    if fields.iter().zip(blocks).any(|(field, block)| field.shape() != block.shape.map(|n| n as usize)) {
        return Err(broken(py, "volumes must fit their blocks"));
    }
    let items: Vec<_> = blocks
        .iter()
        .zip(&fields)
        .zip(scales)
        .map(|((&block, field), scale)| gpu::DeviceItem { block, field, scale })
        .collect();
    let packed =
        run(py, progress, |progress| gpu::DevicePages::pack(&context, page_size, pages, encoding, &items, progress))?;
    Ok(Some(DevicePages { pages: packed, count: pages }))
}

/// Sets the texels of one block to zero.
#[pyfunction]
pub(super) fn atlas_clear<'py>(
    py: Python<'py>,
    mut pages: PyReadwriteArray3<'py, u8>,
    block: Blocks<'py>,
    encoding: &str,
) -> PyResult<()> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let page_size = check_pages(py, pages.shape(), encoding, blocks(&block)?)?;
    for block in blocks(&block)? {
        texels::clear(pages.as_slice_mut()?, page_size, encoding, block);
    }
    Ok(())
}

/// Reads the distances (nx, ny, nz) of one block.
#[pyfunction]
pub(super) fn atlas_read<'py>(
    py: Python<'py>,
    pages: PyReadonlyArray3<'py, u8>,
    block: Blocks<'py>,
    encoding: &str,
    scale: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let page_size = check_pages(py, pages.shape(), encoding, blocks(&block)?)?;
    let block = only(py, &block)?;
    let texels = pages.as_slice()?;
    let samples = run(py, None, |progress| texels::read(texels, page_size, encoding, &block, scale, progress))?;
    volume_array(py, samples, block.shape.map(|n| n as usize))
}

/// Evaluates the field of one block at points (n, 3) of its own space.
#[pyfunction]
#[pyo3(signature = (pages, block, encoding, scale, lower, upper, inner_lower, inner_upper, points, *, filter="linear"))]
pub(super) fn atlas_sample<'py>(
    py: Python<'py>,
    pages: PyReadonlyArray3<'py, u8>,
    block: Blocks<'py>,
    encoding: &str,
    scale: f32,
    lower: [f64; 3],
    upper: [f64; 3],
    inner_lower: [f64; 3],
    inner_upper: [f64; 3],
    #[pyo3(from_py_with = points)] points: Vec<DVec3>,
    filter: &str,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let filter = SampleFilter::from_name(filter).map_err(Failure::from)?;
    let page_size = check_pages(py, pages.shape(), encoding, blocks(&block)?)?;
    let block = only(py, &block)?;
    let grid = grid(&block, lower, upper)?;
    let texels = pages.as_slice()?;
    let inner = [DVec3::from_array(inner_lower), DVec3::from_array(inner_upper)];
    let values = run(py, None, |progress| {
        AtlasField::new(texels, page_size, encoding, scale, &block, grid).sample(&points, inner, filter, progress)
    })?;
    Ok(values.into_pyarray(py))
}

/// Texture coordinates (n, 2) of points (n, 3) on the page.
#[pyfunction]
pub(super) fn atlas_texture_coordinates<'py>(
    py: Python<'py>,
    block: Blocks<'py>,
    page_size: u32,
    lower: [f64; 3],
    upper: [f64; 3],
    #[pyo3(from_py_with = points)] points: Vec<DVec3>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let block = only(py, &block)?;
    let coordinates = texture_coordinates(&block, page_size, &grid(&block, lower, upper)?, &points);
    let count = coordinates.len();
    coordinates.into_flattened().into_pyarray(py).reshape([count, 2])
}

/// The records of all blocks as bytes. `boxes` (n, 12): lower and upper inner corner, lower and upper outer corner.
/// `models` (n, 16): world from field, row by row. The `scales` of float32 are not written.
#[pyfunction]
pub(super) fn atlas_entries<'py>(
    py: Python<'py>,
    blocks: Blocks<'py>,
    boxes: Vec<[f64; 12]>,
    models: Vec<[f64; 16]>,
    scales: Vec<f32>,
    layout: &str,
    page_size: u32,
    encoding: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let layout = Layout::from_name(layout, 0).map_err(Failure::from)?;
    let is_scaled = Encoding::from_name(encoding).map_err(Failure::from)?.is_scaled();
    let mut bytes = Vec::new();
    for (((&block, boxes), model), scale) in self::blocks(&blocks)?.iter().zip(&boxes).zip(&models).zip(scales) {
        let corner = |i: usize| DVec3::from_slice(&boxes[3 * i..]);
        let facts = Facts {
            block,
            inner: [corner(0), corner(1)],
            outer: [corner(2), corner(3)],
            model: DMat4::from_cols_array(model).transpose(),
            scale: is_scaled.then_some(scale),
        };
        let vacant = block.page == VACANT;
        match layout {
            Layout::Strips if vacant => {
                bytes.extend(bytemuck::bytes_of(&StripEntry { atlas_index: -1, ..StripEntry::default() }));
            }
            Layout::Strips => bytes.extend(bytemuck::bytes_of(&facts.strip_entry())),
            Layout::Shelves { .. } if vacant => {
                bytes.extend(bytemuck::bytes_of(&AtlasEntry { atlas_index: -1, ..AtlasEntry::default() }));
            }
            Layout::Shelves { .. } => bytes.extend(bytemuck::bytes_of(&facts.atlas_entry(page_size))),
        }
    }
    Ok(PyBytes::new(py, &bytes))
}

/// The sampling functions of an atlas as text.
#[pyfunction]
pub(super) fn atlas_shader(
    language: &str,
    layout: &str,
    page_size: u32,
    gutter: u32,
    encoding: &str,
    side: u32,
    texels: &str,
) -> PyResult<String> {
    let layout = Layout::from_name(layout, gutter).map_err(Failure::from)?;
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let language = Language::from_name(language).map_err(Failure::from)?;
    let texels = Texels::from_name(texels).map_err(Failure::from)?;
    let options = ShaderOptions { layout, encoding, texels, page_size, side };
    Ok(shader(&options, language).map_err(Failure::from)?)
}

/// Raises an error if the machine does not have this number of bytes free.
#[pyfunction]
pub(super) fn require_memory(what: &str, needed: u64, advice: &str) -> PyResult<()> {
    Ok(memory::require_for(what, needed, 0, advice).map_err(Failure::from)?)
}

fn blocks<'a>(rows: &'a Blocks<'_>) -> PyResult<&'a [AtlasBlock]> {
    let numbers = rows.as_slice().ok().filter(|_| rows.shape()[1] == BLOCK_NUMBERS);
    Ok(bytemuck::cast_slice(numbers.ok_or_else(|| broken(rows.py(), "blocks must be rows of ten numbers"))?))
}

fn only(py: Python<'_>, rows: &Blocks<'_>) -> PyResult<AtlasBlock> {
    match blocks(rows)? {
        [block] => Ok(*block),
        _ => Err(broken(py, "one block is expected")),
    }
}

fn grid(block: &AtlasBlock, lower: [f64; 3], upper: [f64; 3]) -> PyResult<Grid> {
    let shape = block.shape.map(|n| n as usize);
    super::convert::grid(lower, upper, shape)
}

/// The side of square pages, after checking that every block lies on them.
fn check_pages(py: Python<'_>, shape: &[usize], encoding: Encoding, blocks: &[AtlasBlock]) -> PyResult<u32> {
    let [pages, size, row_bytes] = [shape[0], shape[1], shape[2]];
    let page_size = u32::try_from(size).ok().filter(|&size| size <= plan::MAX_PAGE_SIZE);
    let page_size = page_size.filter(|_| row_bytes == size * encoding.bytes());
    let page_size = page_size.ok_or_else(|| broken(py, "pages must be square"))?;
    if blocks.iter().all(|block| block.is_sound(page_size, pages as u32)) {
        Ok(page_size)
    } else {
        Err(broken(py, "a block does not lie on the pages"))
    }
}

/// An error that only a defect of the Python layer can cause.
fn broken(py: Python<'_>, problem: &str) -> PyErr {
    exception(py, "AtlasError", format!("atlas: {problem}"))
}
