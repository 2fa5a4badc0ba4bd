//! The light on the surfaces of a G-buffer.

use crate::scene::light::light_rays::LightWork;
use crate::scene::light::lit_surface::LightSampleMut;
use crate::scene::visibility::gbuffer::{GBuffer, Layer};

/// Light on one layer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LightSample<'a> {
    /// Fraction of the ambient light that arrives.
    pub open: f32,
    /// Fraction of each light that arrives.
    pub shares: &'a [f32],
    /// Fraction of each light, RGB, that arrives through the layer's own instance, weighted for the surface; 0 if it
    /// does not scatter.
    pub through: &'a [[f32; 3]],
}

/// The light on the layers of a G-buffer.
pub(crate) struct LightBuffer {
    /// Number of lights.
    pub lights: usize,
    /// Number of values of a layer.
    pub(crate) stride: usize,
    pub(crate) rows: Vec<LightRow>,
}

#[derive(Default)]
pub(crate) struct LightRow {
    pub is_evaluated: Vec<bool>,
    /// For each layer: ambient fraction, one fraction per light, three fractions per light for transmitted light. In a
    /// buffer of indirect light: RGB.
    pub values: Vec<f32>,
    pub work: Vec<LightWork>,
}

impl LightBuffer {
    /// Nothing evaluated yet; `lights` is None for indirect light.
    pub(crate) fn new(buffer: &GBuffer, lights: Option<usize>) -> Self {
        let stride = lights.map_or(3, stride);
        let row = |layers: &Vec<Layer>| LightRow {
            is_evaluated: vec![false; layers.len()],
            values: vec![0.0; layers.len() * stride],
            work: vec![LightWork::default(); layers.len()],
        };
        Self { lights: lights.unwrap_or(0), stride, rows: buffer.rows.iter().map(row).collect() }
    }

    /// Size of the light on a layer, bytes.
    pub(crate) fn layer_bytes(&self) -> usize {
        size_of::<bool>() + self.stride * size_of::<f32>() + size_of::<LightWork>()
    }

    /// The values of layer `i` in row `y`, and the work for them.
    pub(crate) fn values_at(&self, y: usize, i: usize) -> (&[f32], LightWork) {
        let row = &self.rows[y];
        (&row.values[i * self.stride..][..self.stride], row.work[i])
    }

    /// Whether the light of at most one layer in [`FEW`] is missing.
    pub(crate) fn is_almost_complete(&self) -> bool {
        let evaluated = self.rows.iter().flat_map(|row| &row.is_evaluated);
        let [count, missing] =
            evaluated.fold([0, 0], |[count, missing], evaluated| [count + 1, missing + usize::from(!evaluated)]);
        missing * FEW <= count
    }

    /// Light on layer `i` in row `y`, and the work for it.
    pub(crate) fn at(&self, y: usize, i: usize) -> (LightSample<'_>, LightWork) {
        let (values, work) = self.values_at(y, i);
        let (shares, through) = values[1..].split_at(self.lights);
        (LightSample { open: values[0], shares, through: through.as_chunks().0 }, work)
    }

    /// Replaces interpolated values by the evaluated ones of another buffer.
    pub(crate) fn keep(&mut self, evaluated: Self) {
        let stride = self.stride;
        for (row, evaluated) in self.rows.iter_mut().zip(evaluated.rows) {
            for i in (0..evaluated.is_evaluated.len()).filter(|&i| evaluated.is_evaluated[i]) {
                row.is_evaluated[i] = true;
                row.work[i] = evaluated.work[i];
                row.values[i * stride..][..stride].copy_from_slice(&evaluated.values[i * stride..][..stride]);
            }
        }
    }
}

/// See [`LightBuffer::is_almost_complete`].
const FEW: usize = 32;

/// Number of values of a layer in a picture with this number of lights.
pub(crate) fn stride(lights: usize) -> usize {
    1 + 4 * lights
}

/// The values of a layer as light.
pub(crate) fn parts_of(values: &mut [f32], lights: usize) -> LightSampleMut<'_> {
    let (open, rest) = values.split_first_mut().expect("a layer has `stride` values, at least one");
    let (shares, through) = rest.split_at_mut(lights);
    LightSampleMut { open, shares, through: through.as_chunks_mut().0 }
}
