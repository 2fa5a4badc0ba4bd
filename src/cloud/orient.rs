//! Normals of points without sides: their lines, and the sides of the lines.
//!
//! The line of a point is the axis of least variance of its neighbours. Viewpoints give the sides exactly. Without them
//! there are three candidates, of which the one with the least *score* is kept: the mean of |w- - w+ - 1|, where w- and
//! w+ are the winding numbers behind each point and in front of it. The winding number falls by 1 from behind a surface
//! to its front, also inside another body, where it falls from 2 to 1.
//!
//! 1. The spanning tree of 1 - |n_i.n_j| over the nearest neighbours (Hoppe, DeRose, Duchamp, McDonald, Stuetzle,
//!    *Surface reconstruction from unorganized points*, 1992), whose connected components are turned outward.
//! 2. The iteration of Lin, Shi and Liu, *Fast and globally consistent normal orientation based on the winding number
//!    normal consistency*, 2024. Each round takes a gradient step with exact length on A mu = 1/2, where (A mu)(p) is
//!    the winding number of the area vectors mu, as Lin, Xiao, Hu, Shi, Wang, *Surface reconstruction from point clouds
//!    without normals by parametrizing the Gauss formula*, 2022. Then each mu turns to the steepest descent of the
//!    winding number and keeps its length.
//! 3. The same iteration with a wider range of smoothing.
//!
//! The result is the lines with the chosen sides.

use super::areas::{Areas, first_rows};
use super::neighbours::PointTree;
use super::sums::{ATTRACTION, ChargeTree, GRADIENT, POTENTIAL};
use super::{Frame, PointCloud};
use crate::error::{Error, MeshError};
use crate::mesh::disjoint_sets::DisjointSets;
use crate::progress::Progress;
use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Rounds of the iteration.
const ROUNDS: usize = 40;
/// Ranges of the smoothing width, spacings, from the first round to the last one.
const WIDTHS: [[f64; 2]; 2] = [[2.0, 0.5], [4.0, 2.0]];
/// Most points that iterate. The others take the side of the descent of the winding number.
const MOST_ITERATED: usize = 50_000;
/// Places of the score: their distance from a point, spacings, and the most points that have them.
const SCORE_REACH: f64 = 1.5;
const MOST_SCORED: usize = 5_000;
/// Error of the winding numbers of the score.
const SCORE_ERROR: f64 = 0.02;
/// Neighbours lie on a line if two columns of their covariance, with trace 1, have a smaller cross product.
const LEAST_CROSS: f64 = 1e-10;
/// Progress of the spanning tree and of the scores, rounds.
const OTHER_WORK: usize = 20;

/// Unit normals, and the method that chose their sides: "viewpoints", "tree" or "winding".
pub type Oriented = (Vec<[f64; 3]>, &'static str);

/// Finds unit normals. `lines` may give an axis for each point; zeros stand for the axis of the `count` nearest
/// neighbours. `viewpoints` has one position for each point, on the outer side of it.
pub fn orient(
    points: &[[f64; 3]],
    lines: Option<&[[f64; 3]]>,
    viewpoints: Option<&[[f64; 3]]>,
    count: usize,
    progress: &Progress,
) -> Result<Oriented, Error> {
    let (firsts, distinct) = first_rows(points);
    if distinct.len() < count.max(3) {
        return Err(MeshError::FewPoints { distinct: distinct.len(), least: count.max(3) }.into());
    }
    let frame = Frame::of_points(&distinct);
    let tree = PointTree::new(&distinct, &frame);
    let (neighbours, mut axes) = lines_of(&tree, count, progress)?;
    if let Some(lines) = lines {
        // The last of equal positions gives the line.
        for (line, &first) in lines.iter().zip(&firsts) {
            let line = DVec3::from_array(*line);
            axes[first as usize] = line.try_normalize().unwrap_or(axes[first as usize]);
        }
    }
    let to_rows =
        |normals: &[DVec3]| firsts.iter().map(|&first| normals[first as usize].to_array()).collect::<Vec<_>>();
    if let Some(viewpoints) = viewpoints {
        let mut normals = to_rows(&axes);
        for ((normal, &point), &viewpoint) in normals.iter_mut().zip(points).zip(viewpoints) {
            let (line, away) = (DVec3::from_array(*normal), DVec3::from_array(viewpoint) - DVec3::from_array(point));
            *normal = (if line.dot(away) < 0.0 { -line } else { line }).to_array();
        }
        return Ok((normals, "viewpoints"));
    }

    progress.set_total((WIDTHS.len() * ROUNDS + OTHER_WORK) as u64);
    let areas = Areas::of_neighbours(&distinct, &Progress::new())?.values;
    let spacing = super::areas::quantile(&areas, 0.5).sqrt() / frame.scale;
    let mut candidates = vec![("tree", by_spanning_tree(&tree, &neighbours, count, &axes, &areas))];
    progress.advance(OTHER_WORK as u64)?;
    for widths in WIDTHS {
        let mut normals = by_winding(&tree, &axes, spacing, widths, progress)?;
        turn_outward(&tree.points, &areas, &mut normals, &vec![0; tree.points.len()]);
        candidates.push(("winding", normals));
    }
    let mut best = (f64::INFINITY, 0);
    for (candidate, (_, normals)) in candidates.iter().enumerate() {
        let score = score(&distinct, normals, &areas, progress)?;
        // The first of equal scores stays, and one that is not a number never wins.
        if score < best.0 {
            best = (score, candidate);
        }
    }
    let (method, normals) = &candidates[best.1];
    Ok((to_rows(normals), method))
}

/// The nearest neighbours of each point, `count` for each, and the axis of their least variance.
fn lines_of(tree: &PointTree, count: usize, progress: &Progress) -> Result<(Vec<u32>, Vec<DVec3>), Error> {
    let of_point = |found: &mut Vec<(f64, u32)>, &p: &DVec3| -> Result<(Vec<u32>, DVec3), Error> {
        tree.nearest(p, count, found);
        let rows: Vec<u32> = found.iter().map(|&(_, row)| row).collect();
        progress.check().map(|()| {
            let line = least_axis(rows.iter().map(|&row| tree.points[row as usize] - p));
            (rows, line)
        })
    };
    let parts: Vec<(Vec<u32>, DVec3)> =
        tree.points.par_iter().map_init(Vec::new, of_point).collect::<Result<_, Error>>()?;
    let lines = parts.iter().map(|&(_, line)| line).collect();
    Ok((parts.into_iter().flat_map(|(rows, _)| rows).collect(), lines))
}

/// The axis of least variance of some offsets: the eigenvector of the least eigenvalue of their covariance.
fn least_axis(offsets: impl Iterator<Item = DVec3> + Clone) -> DVec3 {
    let count = offsets.clone().count() as f64;
    let mean = offsets.clone().sum::<DVec3>() / count;
    let mut covariance = DMat3::ZERO;
    for d in offsets.map(|offset| offset - mean) {
        covariance += DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    let trace = covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z;
    let matrix = covariance * (1.0 / trace.max(f64::MIN_POSITIVE));
    // The trigonometric solution for a symmetric matrix with trace 1.
    let shifted = matrix - DMat3::from_diagonal(DVec3::splat(1.0 / 3.0));
    let square = |v: DVec3| v.length_squared();
    let p = ((square(shifted.x_axis) + square(shifted.y_axis) + square(shifted.z_axis)) / 6.0).sqrt();
    let r = (0.5 * (shifted * (1.0 / p.max(f64::MIN_POSITIVE))).determinant()).clamp(-1.0, 1.0);
    let least = 1.0 / 3.0 + 2.0 * p * (r.acos() / 3.0 + 2.0 * PI / 3.0).cos();
    // The longest cross product of two columns of the singular matrix.
    let [a, b, c] = [0, 1, 2].map(|i| matrix.col(i) - DVec3::AXES[i] * least);
    let crosses = [a.cross(b), b.cross(c), c.cross(a)];
    let longest = crosses.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    let along = [a, b, c].into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    // Neighbours on a line have no least axis; any axis across the line suits.
    let across = along.and_then(DVec3::try_normalize).map_or(DVec3::X, |along| along.any_orthonormal_vector());
    longest.filter(|cross| cross.length() > LEAST_CROSS).and_then(DVec3::try_normalize).unwrap_or(across)
}

/// Sides by the minimum spanning tree; its components are turned outward.
fn by_spanning_tree(tree: &PointTree, neighbours: &[u32], count: usize, axes: &[DVec3], areas: &[f64]) -> Vec<DVec3> {
    let weight = |a: u32, b: u32| 1.0 - axes[a as usize].dot(axes[b as usize]).abs();
    let mut edges: Vec<(f32, u32, u32)> = neighbours
        .par_chunks(count)
        .enumerate()
        .flat_map_iter(|(row, near)| near.iter().map(move |&other| (row as u32, other)))
        .filter(|(row, other)| row != other)
        .map(|(row, other)| (weight(row, other) as f32, row.min(other), row.max(other)))
        .collect();
    edges.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut sets = DisjointSets::new(axes.len());
    for (_, a, b) in edges {
        if sets.root(a).0 != sets.root(b).0 {
            sets.join(a, b, axes[a as usize].dot(axes[b as usize]) < 0.0);
        }
    }
    let mut components = Vec::with_capacity(axes.len());
    let mut normals = Vec::with_capacity(axes.len());
    for (row, &axis) in axes.iter().enumerate() {
        let (root, is_flipped) = sets.root(row as u32);
        components.push(root);
        normals.push(if is_flipped { -axis } else { axis });
    }
    turn_outward(&tree.points, areas, &mut normals, &components);
    normals
}

/// Turns the normals of each component whose enclosed volume about its centroid is negative. `components` has the row
/// of a point for each point.
fn turn_outward(points: &[DVec3], areas: &[f64], normals: &mut [DVec3], components: &[u32]) {
    let mut centers = vec![(DVec3::ZERO, 0.0); points.len()];
    for (row, &component) in components.iter().enumerate() {
        centers[component as usize].0 += points[row] * areas[row];
        centers[component as usize].1 += areas[row];
    }
    let mut volumes = vec![0.0; points.len()];
    for (row, &component) in components.iter().enumerate() {
        let (sum, area) = centers[component as usize];
        volumes[component as usize] += areas[row] * normals[row].dot(points[row] - sum / area);
    }
    for (normal, &component) in normals.iter_mut().zip(components) {
        if volumes[component as usize] < 0.0 {
            *normal = -*normal;
        }
    }
}

/// Sides by the iteration of winding numbers.
fn by_winding(
    whole: &PointTree,
    axes: &[DVec3],
    spacing: f64,
    [first, last]: [f64; 2],
    progress: &Progress,
) -> Result<Vec<DVec3>, Error> {
    // An evenly thinned subset, in the order of the tree.
    let step = whole.points.len().div_ceil(MOST_ITERATED);
    let order = whole.bvh.packs.iter().flat_map(|pack| pack.faces().iter().copied());
    let thinned: PointTree;
    let tree = if step == 1 {
        whole
    } else {
        thinned = PointTree::of_local(order.step_by(step).map(|row| whole.points[row as usize]).collect());
        &thinned
    };
    let spacing = spacing * (step as f64).sqrt();
    let points = &tree.points;
    let mut charges = ChargeTree::new(tree);
    // The factor 1 / (4 pi) of the winding number is left out of all sums.
    let half = 2.0 * PI as f32;
    let mut mu = vec![Vec3::ZERO; points.len()];
    let mut width = first * spacing;
    for round in 0..ROUNDS {
        width = (first + (last - first) * round as f64 / (ROUNDS - 1) as f64) * spacing;
        charges.load(&mu);
        let w = charges.sums(POTENTIAL, points, width, progress)?;
        let residual: Vec<Vec3> = w.iter().map(|w| Vec3::new(half - w.x, 0.0, 0.0)).collect();
        charges.load(&residual);
        // The adjoint of A: d changes its sign.
        let attraction = charges.sums(ATTRACTION, points, width, progress)?;
        let slope: Vec<Vec3> = attraction.iter().map(|sum| -*sum).collect();
        charges.load(&slope);
        let along = charges.sums(POTENTIAL, points, width, progress)?;
        let square = |of: &mut dyn Iterator<Item = f64>| of.map(|x| x * x).sum::<f64>();
        let up = square(&mut slope.iter().map(|g| f64::from(g.length())));
        let down = square(&mut along.iter().map(|a| f64::from(a.x)));
        let length = if down > 0.0 { (up / down) as f32 } else { 0.0 };
        mu.iter_mut().zip(&slope).for_each(|(mu, slope)| *mu += length * *slope);
        charges.load(&mu);
        let gradients = charges.sums(GRADIENT, points, width, progress)?;
        for (mu, gradient) in mu.iter_mut().zip(&gradients) {
            *mu = (-*gradient).try_normalize().map_or(*mu, |descent| descent * mu.length());
        }
        progress.advance(1)?;
    }
    charges.load(&mu);
    let descent = charges.sums(GRADIENT, &whole.points, width, progress)?;
    let sided = |(&axis, gradient): (&DVec3, &Vec3)| if axis.dot(gradient.as_dvec3()) > 0.0 { -axis } else { axis };
    Ok(axes.iter().zip(&descent).map(sided).collect())
}

/// The score of normals: the mean difference from 1 of the fall of the winding number across the points.
fn score(points: &[[f64; 3]], normals: &[DVec3], areas: &[f64], progress: &Progress) -> Result<f64, Error> {
    let rows: Vec<[f64; 3]> = normals.iter().map(|normal| normal.to_array()).collect();
    let cloud = PointCloud::new(points, Some(&rows), Some(areas), &Progress::new())?;
    let step = points.len().div_ceil(MOST_SCORED);
    let turned = if cloud.inside_out { -1.0 } else { 1.0 };
    let of_point = |row: usize| -> Result<f64, Error> {
        let reach = SCORE_REACH * areas[row].sqrt();
        let at = |side: f64| {
            let place = DVec3::from_array(points[row]) + normals[row] * (side * reach);
            turned * cloud.winding(cloud.local_from_world(place.to_array()), |_| SCORE_ERROR)
        };
        progress.check().map(|()| (at(-1.0) - at(1.0) - 1.0).abs())
    };
    let scores: Vec<f64> = (0..points.len()).into_par_iter().step_by(step).map(of_point).collect::<Result<_, _>>()?;
    Ok(scores.iter().sum::<f64>() / scores.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::uniform;

    #[test]
    fn the_least_axis_is_the_normal_of_a_plane_and_crosses_a_line() {
        let mut next = uniform(3);
        for _ in 0..200 {
            let mut random = || DVec3::from_array([0; 3].map(|_| next() - 0.5));
            let normal = random().normalize();
            let (u, v) = normal.any_orthonormal_pair();
            let offsets: Vec<DVec3> = (0..12).map(|_| random()).map(|r| u * r.x + v * r.y).collect();
            assert!(least_axis(offsets.iter().copied()).dot(normal).abs() > 1.0 - 1e-9);
            let line: Vec<DVec3> = (0..12).map(|i| u * f64::from(i)).collect();
            assert!(least_axis(line.iter().copied()).dot(u).abs() < 1e-6);
            assert!(least_axis([DVec3::ZERO; 12].into_iter()).is_normalized());
        }
    }
}
