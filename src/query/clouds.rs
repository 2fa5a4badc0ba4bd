//! Nearest points, signed distances and winding numbers of a cloud at arbitrary positions, along the curve of the
//! module.

use super::{AHEAD, CHUNK, OrderedResults, SLACK, curve};
use crate::cloud::{NearestDisk, PointCloud};
use crate::error::{ArgumentError, Error};
use crate::memory::{prefetch, space_for, zeroed_rows};
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;

/// The nearest points of a cloud, and the sides, one entry for each position.
#[derive(Debug, Default)]
pub struct CloudQuery {
    /// World units; negative inside if sides were requested.
    pub distances: Vec<f64>,
    /// Nearest points of the disks, world positions.
    pub points: Vec<[f64; 3]>,
    /// Rows of the points of the cloud.
    pub rows: Vec<i64>,
    /// Number of positions inside.
    pub inside: usize,
    /// Number of positions whose side is a guess: across a hole of the cloud.
    pub undecided: usize,
}

/// Nearest points; with `signed`, negative distances inside.
pub fn query_cloud(
    cloud: &PointCloud,
    points: &[[f64; 3]],
    signed: bool,
    progress: &Progress,
) -> Result<CloudQuery, Error> {
    let scale = cloud.scale();
    let ordered = evaluate(cloud, points, progress, |last: &mut Option<DVec3>, p| {
        let bound = last.map_or(f64::INFINITY, |near| p.distance(near)) * (1.0 + SLACK.0) + SLACK.1;
        let found = cloud.nearest(p, bound);
        *last = Some(found.point);
        let (inside, is_guess) = if signed { cloud.side(p, found.distance * scale) } else { (false, false) };
        (found, inside, is_guess)
    })?;
    let count = points.len();
    let mut found = CloudQuery {
        distances: zeroed_rows("results", count)?,
        points: zeroed_rows("results", count)?,
        rows: zeroed_rows("results", count)?,
        inside: ordered.results.iter().filter(|result| result.1).count(),
        undecided: ordered.results.iter().filter(|result| result.2).count(),
    };
    let columns = found.distances.chunks_mut(CHUNK).zip(found.points.chunks_mut(CHUNK));
    let columns = columns.zip(found.rows.chunks_mut(CHUNK));
    ordered.write_rows(progress, columns, |column, i, (nearest, inside, _): &(NearestDisk, bool, bool)| {
        let ((distances, points), rows) = column;
        let distance = nearest.distance * scale;
        distances[i] = if *inside && distance > 0.0 { -distance } else { distance };
        points[i] = cloud.world_from_local(nearest.point).to_array();
        rows[i] = nearest.row.into();
    })?;
    Ok(found)
}

/// Whether each position is inside.
pub fn cloud_contains(cloud: &PointCloud, points: &[[f64; 3]], progress: &Progress) -> Result<Vec<bool>, Error> {
    evaluate(cloud, points, progress, |(), p| cloud.is_inside(p))?.into_rows(progress)
}

/// The winding number of each position, with an absolute error of at most `error`.
pub fn cloud_winding_numbers(
    cloud: &PointCloud,
    points: &[[f64; 3]],
    error: f64,
    progress: &Progress,
) -> Result<Vec<f64>, Error> {
    evaluate(cloud, points, progress, |(), p| cloud.winding(p, |_| error))?.into_rows(progress)
}

/// Processes every position, with near ones after each other. `work` has a state that lasts for a chunk.
fn evaluate<S: Default, T: Copy + Send>(
    cloud: &PointCloud,
    points: &[[f64; 3]],
    progress: &Progress,
    work: impl Fn(&mut S, DVec3) -> T + Sync,
) -> Result<OrderedResults<T>, Error> {
    if let Some(row) = points.iter().position(|&point| !cloud.can_reach(point)) {
        let problem = format!("points[{row}] = {:?} is too far from the cloud", points[row]);
        return Err(ArgumentError::new("points", problem).into());
    }
    progress.set_total(points.len() as u64);
    let order = curve(points, progress)?;
    let mut results = space_for("results", order.len())?;
    let parts = order.par_chunks(CHUNK).map(|rows| {
        let mut state = S::default();
        let mut part = Vec::with_capacity(rows.len());
        for (i, &row) in rows.iter().enumerate() {
            if let Some(&later) = rows.get(i + AHEAD) {
                prefetch(&points[later as usize]);
            }
            part.push(work(&mut state, cloud.local_from_world(points[row as usize])));
            progress.check()?;
        }
        progress.advance(rows.len() as u64).map(|()| part)
    });
    parts.collect::<Result<Vec<_>, Error>>()?.into_iter().for_each(|part: Vec<T>| results.extend(part));
    Ok(OrderedResults { order, results })
}
