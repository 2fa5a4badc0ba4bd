//! Large allocations that fail with an error before any work is done.

use crate::error::{CapacityError, Error};
use std::alloc::Layout;

/// Least need that is compared with the free memory, bytes. Reading the free memory takes as long as writing this.
const LEAST_CHECKED: u64 = 1 << 22;
/// Memory that stays free for small arrays, bytes: they end the process if they cannot be allocated.
const RESERVE: u64 = 1 << 26;

/// A zeroed buffer of `count` samples, or an error that states its size.
///
/// `scratch` is the additional memory that the job will need, in bytes. Linux grants memory that it does not have, so
/// the free memory is compared first. A limit on the process makes the allocation itself fail.
pub(crate) fn allocate_samples(what: &str, count: usize, scratch: usize) -> Result<Vec<f32>, Error> {
    zeroed(&|| what.to_owned(), count, scratch as u64, ADVICE)
}

/// A result of `count` zero items, in large pages where the system has them: one large page takes one page fault, where
/// 512 small pages take 512. Fails as [`allocate_samples`]; `what` is plural.
pub(crate) fn zeroed_rows<T: bytemuck::Zeroable>(what: &str, count: usize) -> Result<Vec<T>, Error> {
    let mut items = zeroed(&|| array_of(what, count), count, 0, ROWS_ADVICE)?;
    prefer_large_pages(&mut items);
    Ok(items)
}

/// An empty array with space for `count` items. Fails as [`zeroed_rows`].
pub(crate) fn space_for<T>(what: &str, count: usize) -> Result<Vec<T>, Error> {
    require_rows::<T>(what, count)?;
    let mut items = Vec::new();
    let refused = |_| refusal(&array_of(what, count), bytes_of::<T>(count), None, ROWS_ADVICE);
    items.try_reserve_exact(count).map_err(refused)?;
    prefer_large_pages(items.spare_capacity_mut());
    Ok(items)
}

/// Fails if the machine does not have space for `count` more items.
pub(crate) fn require_rows<T>(what: &str, count: usize) -> Result<(), Error> {
    require_lazily(&|| array_of(what, count), bytes_of::<T>(count), 0, ROWS_ADVICE)
}

fn array_of(what: &str, count: usize) -> String {
    format!("an array of {count} {what}")
}

fn bytes_of<T>(count: usize) -> u64 {
    (count as u64).saturating_mul(size_of::<T>() as u64)
}

fn zeroed<T: bytemuck::Zeroable>(
    what: &dyn Fn() -> String,
    count: usize,
    scratch: u64,
    advice: &str,
) -> Result<Vec<T>, Error> {
    let needed = bytes_of::<T>(count);
    require_lazily(what, needed, scratch, advice)?;
    let layout = Layout::array::<T>(count).map_err(|_| refusal(&what(), needed, None, advice))?;
    if layout.size() == 0 {
        return Ok(Vec::new());
    }
    // SAFETY: the layout is not empty. Zeroed memory comes from the system page by page as it is touched, so the worker
    // threads share that cost; `Vec` has no fallible constructor for zeroed memory.
    let start = unsafe { std::alloc::alloc_zeroed(layout) }.cast::<T>();
    if start.is_null() {
        return Err(refusal(&what(), needed, None, advice).into());
    }
    // SAFETY: the global allocator returned `count` items with their alignment, and zero bits are a valid item.
    Ok(unsafe { Vec::from_raw_parts(start, count, count) })
}

/// [`zeroed_rows`] of a table whose memory was required before.
pub(crate) fn zeroed_result<T: bytemuck::Zeroable + Copy>(count: usize) -> Vec<T> {
    let mut items = vec![T::zeroed(); count];
    prefer_large_pages(&mut items);
    items
}

/// [`space_for`] a table whose memory was required before.
pub(crate) fn with_room<T>(count: usize) -> Vec<T> {
    let mut items = Vec::with_capacity(count);
    prefer_large_pages(items.spare_capacity_mut());
    items
}

/// Requests large pages for the memory of a long array. If the system has none, the array keeps small pages.
fn prefer_large_pages<T>(items: &mut [T]) {
    #[cfg(target_os = "linux")]
    {
        use std::ffi::{c_int, c_void};
        const PAGE: usize = 4096;
        const LONG: usize = 1 << 22;
        const MADV_HUGEPAGE: c_int = 14;
        unsafe extern "C" {
            fn madvise(start: *mut c_void, length: usize, advice: c_int) -> c_int;
        }
        let length = size_of_val(items);
        let start = items.as_mut_ptr().cast::<u8>();
        let skipped = start.align_offset(PAGE);
        if length >= LONG && skipped < length {
            // SAFETY: the pages lie within the array, and this advice changes no content. A failure leaves the array as
            // it was.
            unsafe { madvise(start.wrapping_add(skipped).cast(), (length - skipped) / PAGE * PAGE, MADV_HUGEPAGE) };
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = items;
}

/// Fails if the machine does not have `needed` plus `scratch` bytes free.
pub(crate) fn require(what: &str, needed: u64, scratch: u64) -> Result<(), Error> {
    require_for(what, needed, scratch, ADVICE)
}

/// [`require`] with a remedy for the message.
pub(crate) fn require_for(what: &str, needed: u64, scratch: u64, advice: &str) -> Result<(), Error> {
    require_lazily(&|| what.to_owned(), needed, scratch, advice)
}

/// [`require_for`] of a text that is made for the message only: a query of one point takes a few microseconds.
fn require_lazily(what: &dyn Fn() -> String, needed: u64, scratch: u64, advice: &str) -> Result<(), Error> {
    let total = needed.saturating_add(scratch);
    if total < LEAST_CHECKED {
        return Ok(());
    }
    let available = machine_bytes().min(address_space().unwrap_or(u64::MAX));
    if total > available { Err(refusal(&what(), needed, Some(available), advice).into()) } else { Ok(()) }
}

/// [`require`] of memory that the driver of a software device allocates. The driver fails with an error of its own at
/// the limit of the address space.
pub(crate) fn require_for_device(what: &str, needed: u64) -> Result<(), Error> {
    let available = machine_bytes();
    if needed > available { Err(refusal(what, needed, Some(available), ADVICE).into()) } else { Ok(()) }
}

/// Brings a value into the cache.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let start = std::ptr::from_ref(value).cast::<i8>();
        for line in (0..size_of::<T>()).step_by(64) {
            // SAFETY: a prefetch reads nothing, and the address lies within the value.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(start.add(line)) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

/// Remedy for a grid that does not fit.
const ADVICE: &str = "lower the resolution, or bake parts of the box through bounds=";

/// Remedy for points, rays and results that do not fit.
const ROWS_ADVICE: &str = "pass fewer at a time";

fn refusal(what: &str, needed: u64, available: Option<u64>, advice: &str) -> CapacityError {
    CapacityError { what: what.to_owned(), needed, available, advice: advice.to_owned() }
}

/// Free memory of the machine, or of the container where that is less. Neither counts the file cache as used, since the
/// system drops it when memory is needed.
fn machine_bytes() -> u64 {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let machine = if system.available_memory() > 0 { system.available_memory() } else { u64::MAX };
    system.cgroup_limits().map_or(machine, |limits| machine.min(limits.total_memory.saturating_sub(limits.rss)))
}

/// Addresses that the process may still use, bytes, less [`RESERVE`]; None without a limit (`ulimit -v`).
fn address_space() -> Option<u64> {
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    let limit: u64 = number_after(&limits, "Max address space")?;
    let used = number_after(&std::fs::read_to_string("/proc/self/status").ok()?, "VmSize:")?.saturating_mul(1024);
    Some(limit.saturating_sub(used).saturating_sub(RESERVE))
}

/// The number that follows a label in a text of the kernel; None for a word such as "unlimited".
fn number_after(text: &str, label: &str) -> Option<u64> {
    text.lines().find_map(|line| line.strip_prefix(label))?.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_start_at_zero() {
        assert_eq!(allocate_samples("a test", 1000, 0).unwrap(), vec![0.0; 1000]);
        assert!(allocate_samples("a test", 0, 0).unwrap().is_empty());
    }

    #[test]
    fn rows_start_at_zero_or_are_refused() {
        assert_eq!(zeroed_rows::<[f64; 3]>("points", 1000).unwrap(), vec![[0.0; 3]; 1000]);
        assert!(zeroed_rows::<u64>("points", 0).unwrap().is_empty());
        assert!(space_for::<u64>("keys", 1000).unwrap().capacity() >= 1000);
        for error in [zeroed_rows::<u64>("points", 1 << 50).err(), space_for::<u64>("points", 1 << 50).err()] {
            let error = error.unwrap().to_string();
            assert!(error.starts_with("an array of 1125899906842624 points needs 9007199254740992 bytes"), "{error}");
        }
        assert!(zeroed_rows::<u64>("points", usize::MAX).is_err() && space_for::<u64>("points", usize::MAX).is_err());
    }

    #[test]
    fn numbers_follow_their_labels() {
        let limits =
            "Max cpu time  unlimited\nMax address space         2147483648           unlimited            bytes";
        assert_eq!(number_after(limits, "Max address space"), Some(2147483648));
        assert_eq!(number_after(limits, "Max cpu time"), None);
    }

    #[test]
    fn what_cannot_fit_is_refused_with_its_size() {
        let error = allocate_samples("a field of 4096 x 4096 x 65536 samples", 1 << 40, 0).unwrap_err().to_string();
        assert!(
            error.starts_with("a field of 4096 x 4096 x 65536 samples needs 4398046511104 bytes (4096.0 GiB)"),
            "{error}"
        );
        assert!(allocate_samples("a test", usize::MAX, usize::MAX).is_err());
    }
}
