//! The amount of work in one dispatch.
//!
//! A long dispatch triggers the driver's watchdog (two seconds on some systems) and cannot be cancelled; a short one
//! wastes the device. The time of an invocation is unknown and differs by a factor of ten thousand between a software
//! adapter and a large GPU. The size is therefore adapted while the job runs: doubled while dispatches are quick,
//! halved when they are slow.

use super::context::Context;
use crate::error::Error;
use crate::progress::Progress;
use std::time::{Duration, Instant};

/// After a dispatch that is quicker than this, the next one is twice as large.
const QUICK: Duration = Duration::from_millis(40);
/// After a dispatch that is slower than this, the next one is half as large.
const SLOW: Duration = Duration::from_millis(160);

/// Number of invocations of a workgroup of the kernels with one invocation for each item of a list, as in the shaders.
const GROUP: u64 = 64;
/// Number of workgroups of a dispatch of these kernels: at least, so that 256 items of the slowest shape take less than
/// [`SLOW`] on software adapters, and at most, by the limit of one dimension.
const GROUPS: (u64, u64) = (4, 65_535);

/// [`in_pieces`] for the items of a list, with one invocation for each. `dispatch(first, count, workgroups)` submits
/// `count` items from `first` on.
pub(crate) fn in_groups(
    context: &Context,
    what: &str,
    total: usize,
    progress: &Progress,
    dispatch: impl FnMut(u32, u32, [u32; 3]) -> Result<wgpu::SubmissionIndex, Error>,
) -> Result<(), Error> {
    in_groups_from(context, what, total, &mut 0, progress, dispatch)
}

/// [`in_groups`] for a job that is repeated. `size` is the number of workgroups of the first dispatch, or 0 for
/// the default; it becomes the number with which the same job should start the next time.
pub(crate) fn in_groups_from(
    context: &Context,
    what: &str,
    total: usize,
    size: &mut u64,
    progress: &Progress,
    mut dispatch: impl FnMut(u32, u32, [u32; 3]) -> Result<wgpu::SubmissionIndex, Error>,
) -> Result<(), Error> {
    let groups = (total as u64).div_ceil(GROUP);
    adapted(context, what, groups, GROUPS, size, progress, |first, groups| {
        let first = GROUP * first;
        let count = (GROUP * groups).min(total as u64 - first);
        dispatch(first as u32, count as u32, [groups as u32, 1, 1])
    })
}

/// Longest predicted duration of a submission, s. The prediction may be too short by a factor of four.
const LONG: f64 = 0.5;

/// Items of a job whose cost is known in advance except for a factor. Any range of at least 64 items must have about
/// the mean cost.
pub(crate) struct Items {
    pub count: u64,
    /// Number of items of the first submission if the factor is unknown.
    pub smallest: u64,
    /// Mean amount of work of an item, in any unit.
    pub cost: f64,
}

/// Splits a job that is repeated into submissions, each as large as [`LONG`] permits. `rate` is the time for one unit
/// of work in s, or 0 if it is unknown; it becomes the one of this job. `submit(first, count)` submits items.
pub(crate) fn by_rate(
    context: &Context,
    what: &str,
    items: &Items,
    rate: &mut f64,
    progress: &Progress,
    mut submit: impl FnMut(u64, u64) -> Result<wgpu::SubmissionIndex, Error>,
) -> Result<(), Error> {
    let longest = |rate: f64| ((LONG / (rate * items.cost)) as u64).max(items.smallest);
    let mut size = if *rate > 0.0 { longest(*rate) } else { items.smallest };
    let mut measured: Vec<(u64, f64)> = Vec::new();
    let mut first = 0;
    let mut waiting: Option<(u64, wgpu::SubmissionIndex)> = None;
    let mut since = Instant::now();
    while first < items.count || waiting.is_some() {
        let count = size.min(items.count - first);
        let next = if count > 0 { Some((count, submit(first, count)?)) } else { None };
        first += count;
        if let Some((count, earlier)) = std::mem::replace(&mut waiting, next) {
            context.wait(what, &earlier, progress)?;
            let seconds = since.elapsed().as_secs_f64();
            since = Instant::now();
            measured.push((count, seconds));
            size = longest(seconds / (count as f64 * items.cost)).min(2 * size);
        }
        progress.check()?;
    }
    *rate = seconds_per_item(&measured).map_or(*rate, |seconds| seconds / items.cost);
    Ok(())
}

/// The time of an item by the numbers of items of submissions and their times, s: the mean over the large submissions.
/// The small ones include the compilation of kernels at their first use. The time of a single submission may be too
/// short, since the next one already runs while the host waits; the sum of such times is correct.
fn seconds_per_item(measured: &[(u64, f64)]) -> Option<f64> {
    let largest = measured.iter().map(|&(count, _)| count).max()?;
    let large = measured.iter().filter(|&&(count, _)| 2 * count >= largest);
    let (count, seconds) = large.fold((0, 0.0), |(count, seconds), part| (count + part.0, seconds + part.1));
    (count > 0).then(|| seconds / count as f64)
}

/// Splits `total` units of work into dispatches. `dispatch(first, count)` submits one. Results do not depend on the
/// split.
///
/// Two dispatches are in flight, so that the device does not wait for the CPU.
pub(crate) fn in_pieces(
    context: &Context,
    what: &str,
    total: u64,
    smallest: u64,
    largest: u64,
    progress: &Progress,
    dispatch: impl FnMut(u64, u64) -> Result<wgpu::SubmissionIndex, Error>,
) -> Result<(), Error> {
    adapted(context, what, total, (smallest, largest), &mut 0, progress, dispatch)
}

/// [`in_pieces`] that starts with dispatches of `size` units. Sets `size` to the number with which the same job should
/// start the next time: a quarter of the last adapted one, since the job may be slower then.
fn adapted(
    context: &Context,
    what: &str,
    total: u64,
    (smallest, largest): (u64, u64),
    size: &mut u64,
    progress: &Progress,
    mut dispatch: impl FnMut(u64, u64) -> Result<wgpu::SubmissionIndex, Error>,
) -> Result<(), Error> {
    let mut pace = Pace { size: (*size).clamp(smallest, largest), smallest, largest };
    let mut first = 0;
    let mut waiting: Option<wgpu::SubmissionIndex> = None;
    let mut since = Instant::now();
    while first < total {
        let count = pace.size.min(total - first);
        let submission = dispatch(first, count)?;
        first += count;
        if let Some(earlier) = waiting.replace(submission) {
            context.wait(what, &earlier, progress)?;
            pace.adapt(since.elapsed());
            since = Instant::now();
        }
        progress.check()?;
    }
    if let Some(last) = waiting {
        context.wait(what, &last, progress)?;
        // The last dispatch may be small, so a short time shows nothing.
        pace.adapt(since.elapsed().max(QUICK));
    }
    // A job of few dispatches shows only that its first size is not too large.
    *size = if pace.size < *size { pace.size / 4 } else { (*size).max(pace.size / 4) };
    Ok(())
}

/// The size of the next dispatch, and its limits.
struct Pace {
    size: u64,
    smallest: u64,
    largest: u64,
}

impl Pace {
    /// Adapts the size to the duration of a dispatch.
    fn adapt(&mut self, took: Duration) {
        if took < QUICK {
            self.size = (self.size * 2).min(self.largest);
        } else if took > SLOW {
            self.size = (self.size / 2).max(self.smallest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::seconds_per_item;

    #[test]
    fn the_time_of_an_item_is_the_mean_of_the_large_submissions() {
        assert_eq!(seconds_per_item(&[]), None);
        // The first submission includes the compilation of kernels. The host woke late after the fourth one, whose time
        // contains the time of the fifth.
        let measured = [(4, 9.0), (4, 0.1), (8, 0.2), (16, 47.0), (32, 1.0), (16, 16.0)];
        assert_eq!(seconds_per_item(&measured), Some(1.0));
        assert_eq!(seconds_per_item(&[(30, 120.0)]), Some(4.0));
    }
}
