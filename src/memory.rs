//! Large allocations that fail with an error before any work is done.

use crate::error::{CapacityError, Error};
use std::alloc::Layout;

/// A zeroed buffer of `count` samples, or an error that states its size.
///
/// `scratch` is the additional memory that the job will need, in bytes. Linux grants memory that it does not have, so
/// the free memory is compared first. A limit on the process makes the allocation itself fail.
pub(crate) fn allocate_samples(what: &str, count: usize, scratch: usize) -> Result<Vec<f32>, Error> {
    let needed = (count as u64).saturating_mul(size_of::<f32>() as u64);
    require(what, needed, scratch as u64)?;
    let layout = Layout::array::<f32>(count).map_err(|_| refusal(what, needed, None, ADVICE))?;
    if layout.size() == 0 {
        return Ok(Vec::new());
    }
    // SAFETY: the layout is not empty. Zeroed memory comes from the system page by page as it is touched, so the worker
    // threads share that cost; `Vec` has no fallible constructor for zeroed memory.
    let start = unsafe { std::alloc::alloc_zeroed(layout) }.cast::<f32>();
    if start.is_null() {
        return Err(refusal(what, needed, None, ADVICE).into());
    }
    // SAFETY: the global allocator gave `count` floats with a float's alignment, and zero bits are the float zero.
    Ok(unsafe { Vec::from_raw_parts(start, count, count) })
}

/// A result of `count` zero items, in large pages where the system has them: one large page takes one page fault, where
/// 512 small pages take 512.
pub(crate) fn zeroed_result<T: bytemuck::Zeroable + Copy>(count: usize) -> Vec<T> {
    let mut items = vec![T::zeroed(); count];
    prefer_large_pages(&mut items);
    items
}

/// An empty array with space for `count` items, in large pages where the system has them.
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
    let available = available_bytes();
    if needed.saturating_add(scratch) > available {
        Err(refusal(what, needed, Some(available), advice).into())
    } else {
        Ok(())
    }
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

fn refusal(what: &str, needed: u64, available: Option<u64>, advice: &str) -> CapacityError {
    CapacityError { what: what.to_owned(), needed, available, advice: advice.to_owned() }
}

/// Free memory of the machine, or of the container where that is less. Neither counts the file cache as used, since the
/// system drops it when memory is needed.
fn available_bytes() -> u64 {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let machine = if system.available_memory() > 0 { system.available_memory() } else { u64::MAX };
    system.cgroup_limits().map_or(machine, |limits| machine.min(limits.total_memory.saturating_sub(limits.rss)))
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
    fn what_cannot_fit_is_refused_with_its_size() {
        let error = allocate_samples("a field of 4096 x 4096 x 65536 samples", 1 << 40, 0).unwrap_err().to_string();
        assert!(
            error.starts_with("a field of 4096 x 4096 x 65536 samples needs 4398046511104 bytes (4096.0 GiB)"),
            "{error}"
        );
        assert!(allocate_samples("a test", usize::MAX, usize::MAX).is_err());
    }
}
