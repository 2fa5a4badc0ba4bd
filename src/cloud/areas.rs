//! Areas of points from their neighbours.
//!
//! A disk through the eighth neighbour at distance r contains eight points of a surface, so the area of a point is `pi
//! r^2 / 8`. It follows the density: at 20 : 1 no side was wrong beyond a spacing, where equal areas gave 2 %. Equal
//! positions share the area of one. An outlier far from all others would get a huge area, so areas are capped.

use super::Frame;
use super::neighbours::PointTree;
use crate::error::{Error, MeshError};
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use std::f64::consts::PI;

/// Number of neighbours, without the point itself, in the disk of a point.
const NEIGHBOURS: usize = 8;
/// Largest area, in medians of all areas.
const CAP: f64 = 25.0;

/// The areas of points, world units.
#[derive(Debug, Clone, Default)]
pub struct Areas {
    /// One area for each point.
    pub values: Vec<f64>,
    /// Number of areas that were capped.
    pub outliers: usize,
    /// Number of points that repeat an earlier one.
    pub duplicates: usize,
}

impl Areas {
    /// Areas of the caller.
    pub(super) fn given(points: &[[f64; 3]], areas: &[f64]) -> Self {
        let duplicates = points.len() - first_rows(points).1.len();
        Self { values: areas.to_vec(), outliers: 0, duplicates }
    }

    pub(super) fn of_neighbours(points: &[[f64; 3]], progress: &Progress) -> Result<Self, Error> {
        let (firsts, distinct) = first_rows(points);
        let mut areas = distinct_areas(&distinct, progress)?;
        let limit = CAP * quantile(&areas, 0.5);
        let mut outliers = 0;
        for area in &mut areas {
            outliers += usize::from(*area > limit);
            *area = area.min(limit);
        }
        let mut copies = vec![0u32; distinct.len()];
        firsts.iter().for_each(|&first| copies[first as usize] += 1);
        let values = firsts.iter().map(|&first| areas[first as usize] / f64::from(copies[first as usize])).collect();
        Ok(Self { values, outliers, duplicates: points.len() - distinct.len() })
    }

    /// The median and the 95th percentile of the spacing, the square root of an area. Points without areas have the
    /// areas of their neighbours; 0 for fewer than nine points.
    pub(super) fn spacings(&self, points: &[[f64; 3]], progress: &Progress) -> Result<(f64, f64), Error> {
        let (median, high) = (quantile(&self.values, 0.5), quantile(&self.values, 0.95));
        if median > 0.0 {
            return Ok((median.sqrt(), high.sqrt()));
        }
        let distinct = first_rows(points).1;
        if distinct.len() <= NEIGHBOURS {
            return Ok((0.0, 0.0));
        }
        let areas = distinct_areas(&distinct, progress)?;
        Ok((quantile(&areas, 0.5).sqrt(), quantile(&areas, 0.95).sqrt()))
    }
}

/// The areas of distinct points, before they are capped.
fn distinct_areas(points: &[[f64; 3]], progress: &Progress) -> Result<Vec<f64>, Error> {
    if points.len() <= NEIGHBOURS {
        return Err(MeshError::FewPoints { distinct: points.len(), least: NEIGHBOURS + 1 }.into());
    }
    let frame = Frame::of_points(points);
    let tree = PointTree::new(points, &frame);
    progress.set_total(points.len() as u64);
    // Points of a pack are near each other, so their searches share the nodes in the cache.
    let of_pack = |pack: &crate::bvh::pack::Pack| -> Result<Vec<(u32, f64)>, Error> {
        let mut found = Vec::with_capacity(NEIGHBOURS + 1);
        let areas = pack.faces().iter().map(|&row| {
            tree.nearest(tree.points[row as usize], NEIGHBOURS + 1, &mut found);
            (row, PI * found[NEIGHBOURS].0 / 8.0 * frame.scale * frame.scale)
        });
        let areas = areas.collect();
        progress.advance(pack.faces().len() as u64).map(|()| areas)
    };
    let parts = tree.bvh.packs.par_iter().map(of_pack).collect::<Result<Vec<_>, Error>>()?;
    let mut areas = vec![0.0; points.len()];
    parts.into_iter().flatten().for_each(|(row, area)| areas[row as usize] = area);
    Ok(areas)
}

/// The index of the distinct position of each point, and the distinct positions.
pub(super) fn first_rows(points: &[[f64; 3]]) -> (Vec<u32>, Vec<[f64; 3]>) {
    let mut index_of: FxHashMap<[u64; 3], u32> = FxHashMap::default();
    let mut distinct = Vec::new();
    let firsts = points.iter().map(|&p| {
        // The sum turns -0 into 0.
        let key = (DVec3::from_array(p) + DVec3::ZERO).to_array().map(f64::to_bits);
        *index_of.entry(key).or_insert_with(|| {
            distinct.push(p);
            distinct.len() as u32 - 1
        })
    });
    (firsts.collect(), distinct)
}

/// A quantile of some values; there is at least one.
pub(super) fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    let place = (share * (sorted.len() - 1) as f64) as usize;
    *sorted.select_nth_unstable_by(place, f64::total_cmp).1
}
