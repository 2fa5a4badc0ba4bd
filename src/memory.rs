//! Large allocations that fail as an error, before any work is done.

use crate::error::{CapacityError, Error};

/// A zeroed buffer of `count` samples, or an error that tells its size.
///
/// `scratch` is what the job will need besides. Linux grants memory it does not have, so the free memory is asked for
/// first; a limit on the process shows in the allocation itself.
pub fn allocate_samples(what: &str, count: usize, scratch: usize) -> Result<Vec<f32>, Error> {
    let needed = (count as u64).saturating_mul(size_of::<f32>() as u64).saturating_add(scratch as u64);
    let refuse = |available| CapacityError {
        what: what.to_owned(),
        needed,
        available,
        advice: "lower the resolution, or bake parts of the box through bounds=",
    };
    let available = available_bytes();
    if needed > available {
        return Err(refuse(Some(available)).into());
    }
    let mut samples = Vec::new();
    samples.try_reserve_exact(count).map_err(|_| refuse(None))?;
    samples.resize(count, 0.0);
    Ok(samples)
}

/// Free memory of the machine, or of the container where that is less.
fn available_bytes() -> u64 {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    let machine = if system.available_memory() > 0 { system.available_memory() } else { u64::MAX };
    system.cgroup_limits().map_or(machine, |limits| machine.min(limits.free_memory))
}
