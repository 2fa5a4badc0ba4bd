//! A table in device memory that is written again only where its rows change.

use super::context::Context;
use crate::error::DeviceError;
use bytemuck::Pod;

/// Rows that are equal between two changed ones are written too if they are at most this many: a write has a cost of
/// its own.
const GAP: usize = 8;

/// A storage buffer, and a copy of its rows in host memory.
#[derive(Debug)]
pub(crate) struct Table<T> {
    label: &'static str,
    buffer: wgpu::Buffer,
    rows: Vec<T>,
}

impl<T: Pod> Table<T> {
    pub(crate) fn new(context: &Context, label: &'static str, rows: Vec<T>) -> Result<Self, DeviceError> {
        Ok(Self { label, buffer: context.upload(label, &rows)?, rows })
    }

    pub(crate) fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Replaces the rows. Only ranges that differ are uploaded; a larger table gets a new buffer.
    pub(crate) fn set(&mut self, context: &Context, rows: Vec<T>) -> Result<(), DeviceError> {
        if size_of_val(&rows[..]) as u64 > self.buffer.size() {
            *self = Self::new(context, self.label, rows)?;
            return Ok(());
        }
        for range in changed(&self.rows, &rows) {
            let offset = (range.start * size_of::<T>()) as u64;
            context.write(self.label, &self.buffer, offset, &rows[range])?;
        }
        self.rows = rows;
        Ok(())
    }
}

/// Ranges of rows that differ from the earlier ones, by their bytes. Close ranges are joined.
fn changed<T: Pod>(before: &[T], after: &[T]) -> Vec<std::ops::Range<usize>> {
    let mut ranges: Vec<std::ops::Range<usize>> = Vec::new();
    for (i, row) in after.iter().enumerate() {
        if before.get(i).is_some_and(|before| bytemuck::bytes_of(before) == bytemuck::bytes_of(row)) {
            continue;
        }
        match ranges.last_mut() {
            Some(last) if i - last.end <= GAP => last.end = i + 1,
            _ => ranges.push(i..i + 1),
        }
    }
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_cover_what_differs() {
        let one = |range: std::ops::Range<usize>| vec![range];
        let before: Vec<u32> = (0..100).collect();
        let mut after = before.clone();
        assert!(changed(&before, &after).is_empty());
        (after[3], after[9], after[60]) = (0, 0, 0);
        assert_eq!(changed(&before, &after), [3..10, 60..61]);
        after.truncate(50);
        assert_eq!(changed(&before, &after), one(3..10));
        after.extend(50..110);
        assert_eq!(changed(&before, &after), [3..10, 100..110]);
        assert_eq!(changed(&[], &[f32::NAN]), one(0..1));
        assert!(changed(&[f32::NAN], &[f32::NAN]).is_empty());
    }
}
