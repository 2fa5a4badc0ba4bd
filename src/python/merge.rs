//! `fieldbake._core.merge`.

use super::convert::{Field, grid, volume_array};
use super::device::choose;
use super::error::{Failure, exception};
use super::quadric::quadric_rows;
use super::run::run;
use crate::error::{DeviceError, Error};
use crate::gpu::Place;
use crate::merge::{Merged, Placed, merge as merge_all, merge_on_device, update};
use crate::quadric::local::Local;
use glam::{DAffine3, DMat4, DVec3};
use numpy::{
    IntoPyArray, PyArray1, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Samples, box and inner box of a volume.
type VolumeRow<'py> = (PyReadonlyArray3<'py, f32>, [f64; 3], [f64; 3], [f64; 3], [f64; 3]);
/// Distances and owners of an earlier merge, and the indices of the moved instances.
type Previous<'py> = (PyReadonlyArray3<'py, f32>, PyReadonlyArray1<'py, u32>, Vec<u32>);

/// Distances, owners and report.
type MergeArrays<'py> = (Bound<'py, PyArray3<f32>>, Option<Bound<'py, PyArray1<u32>>>, Bound<'py, PyDict>);

/// Merges placed volumes and quadrics into one field.
#[pyfunction]
#[pyo3(signature = (
    volumes, instances, transforms, quadrics, lower, upper, shape, *, previous=None, device="auto",
    progress=None
))]
pub(super) fn merge<'py>(
    py: Python<'py>,
    volumes: Vec<VolumeRow<'py>>,
    instances: Vec<usize>,
    transforms: PyReadonlyArray3<'py, f64>,
    quadrics: PyReadonlyArray2<'py, f64>,
    lower: [f64; 3],
    upper: [f64; 3],
    shape: [usize; 3],
    previous: Option<Previous<'py>>,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<MergeArrays<'py>> {
    let wrong = |message: String| exception(py, "ArgumentError", message);
    let grid = grid(lower, upper, shape)?;
    let fields: Vec<_> = volumes
        .iter()
        .map(|(samples, lower, upper, inner_lower, inner_upper)| {
            let inner = [*inner_lower, *inner_upper].map(DVec3::from_array);
            Ok((Field::new(samples, *lower, *upper)?.view().map_err(Failure::from)?, inner))
        })
        .collect::<PyResult<_>>()?;
    let matrices = transforms.as_slice().ok().filter(|_| transforms.shape() == [instances.len(), 4, 4]);
    let matrices = matrices.ok_or_else(|| wrong("transforms: must be a C-contiguous (n, 4, 4) array".into()))?;
    let mut placed = Vec::with_capacity(instances.len());
    for (&index, matrix) in instances.iter().zip(matrices.as_chunks::<16>().0) {
        let &(field, inner) =
            fields.get(index).ok_or_else(|| wrong(format!("instances: there is no volume {index}")))?;
        // Rows in Python are columns here.
        let transform = DAffine3::from_mat4(DMat4::from_cols_slice(matrix).transpose());
        placed.push(Placed::volume(field, inner, transform).map_err(Failure::from)?);
    }
    placed.extend(quadric_rows(&quadrics)?.iter().map(|quadric| Placed::quadric(Local::new(quadric))));

    let place = choose(py, device)?;
    let facts = PyDict::new(py);
    facts.set_item("device", Place::Cpu.label())?;
    let earlier = match &previous {
        None => None,
        Some((distances, owners, changed)) => {
            let distances = Field::new(distances, lower, upper)?.view().map_err(Failure::from)?.distances();
            let owners = owners.as_slice()?;
            if distances.len() != grid.len() || owners.len() != grid.len() {
                return Err(wrong(format!("previous: expected {} samples", grid.len())));
            }
            Some((distances, owners, changed))
        }
    };
    if let (Place::Gpu(context), None) = (&place, &earlier) {
        match run(py, progress, |progress| merge_on_device(context, &grid, &placed, progress)) {
            Ok((merged, undecided)) => {
                facts.set_item("device", place.label())?;
                facts.set_item("undecided", undecided)?;
                return results(py, merged, shape, facts);
            }
            // If the user did not request a device, exceeding its limits is not an error.
            Err(Failure::Core(Error::Device(DeviceError::TooLarge { what, needed, limit, .. })))
                if device == "auto" =>
            {
                let warning = format!("merged on the CPU: {what} need {needed} bytes, the device allows {limit}");
                facts.set_item("warnings", [warning])?;
            }
            Err(failure) => return Err(failure.into()),
        }
    }
    let merged = run(py, progress, |progress| -> Result<Merged, Error> {
        let Some((distances, owners, changed)) = earlier else { return merge_all(&grid, &placed, progress) };
        let mut merged = Merged { distances: distances.to_vec(), owners: owners.to_vec(), evaluations: 0 };
        update(&grid, &placed, changed, &mut merged, progress)?;
        Ok(merged)
    })?;
    results(py, merged, shape, facts)
}

fn results<'py>(
    py: Python<'py>,
    merged: Merged,
    shape: [usize; 3],
    facts: Bound<'py, PyDict>,
) -> PyResult<MergeArrays<'py>> {
    facts.set_item("evaluations", merged.evaluations)?;
    Ok((volume_array(py, merged.distances, shape)?, Some(merged.owners.into_pyarray(py)), facts))
}
