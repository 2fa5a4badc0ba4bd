//! A sparse field in a scene, read directly from its bricks.

use super::device_fields::DeviceFields;
use super::field::{OnDevice, SampledField};
use crate::error::{DeviceError, Error};
use crate::grid::Grid;
use crate::march::blocks::Blocks;
use crate::march::bricks::MaskedBricks;
use crate::progress::Progress;
use crate::volume::sparse::{SparseField, SparseView};
use crate::volume::{Cell, Trilinear};
use glam::{DVec3, IVec3};

self_cell::self_cell!(
    struct Owned {
        owner: SparseField<f32>,
        #[covariant]
        dependent: Bricks,
    }
);

type Bricks<'a> = MaskedBricks<'a, f32>;

/// A sparse field prepared for rays.
pub(crate) struct SparseBricks(Owned);

impl SparseBricks {
    pub(crate) fn new(field: SparseField<f32>, progress: &Progress) -> Result<Self, Error> {
        Ok(Self(Owned::try_new(field, |field| MaskedBricks::new(field.view()?, progress))?))
    }

    fn bricks(&self) -> &Bricks<'_> {
        self.0.borrow_dependent()
    }

    pub(crate) fn view(&self) -> &SparseView<'_, f32> {
        self.bricks().view()
    }
}

impl Trilinear for SparseBricks {
    fn grid(&self) -> &Grid {
        self.bricks().grid()
    }

    #[inline]
    fn cell(&self, index: IVec3) -> Cell {
        self.bricks().cell(index)
    }

    fn distance_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f32 {
        self.bricks().distance_bound(p, inner)
    }
}

impl Blocks for SparseBricks {
    const SIDE: i32 = <Bricks<'static> as Blocks>::SIDE;
    type Block<'b> = <Bricks<'b> as Blocks>::Block<'b>;
    type Signs = ();

    fn signs(&self, progress: &Progress) -> Result<(), Error> {
        self.bricks().signs(progress)
    }

    fn occupied(&self, signs: &()) -> Vec<bool> {
        self.bricks().occupied(signs)
    }

    #[inline]
    fn block<'b>(&'b self, signs: &'b (), index: [i32; 3]) -> <Bricks<'b> as Blocks>::Block<'b> {
        self.bricks().block(signs, index)
    }
}

impl OnDevice for SparseBricks {
    fn append_to(field: &SampledField<Self>, tables: &mut DeviceFields<'_>) -> Result<(), DeviceError> {
        let marcher = field.marcher();
        tables.add_sparse(marcher.field.view(), marcher.empty())
    }
}
