//! Positions of new fields, given the occupied blocks.

use super::rectangles::FreeArea;
use super::{AtlasBlock, Layout};
use crate::error::{AtlasError, Error};

/// Largest side of a page: twice the limit of current devices. Texel offsets fit in an i32.
pub(crate) const MAX_PAGE_SIZE: u32 = 1 << 15;

/// Largest number of pages of an atlas, far beyond the memory of any machine.
const MAX_PAGES: u32 = 1 << 16;

/// Places fields of the given shapes on pages of `page_size` squared, beside the blocks that are `taken`. Blocks start
/// at multiples of `align` texels along x. New pages are opened as needed; occupied blocks do not move.
pub(crate) fn plan(
    layout: Layout,
    page_size: u32,
    align: u32,
    taken: &[AtlasBlock],
    shapes: &[[u32; 3]],
) -> Result<Vec<AtlasBlock>, Error> {
    match layout {
        Layout::Strips => plan_strips(page_size, taken, shapes),
        Layout::Shelves { gutter } => plan_shelves(page_size, gutter, align, taken, shapes),
    }
}

/// Rows of the article, the lowest free one first.
fn plan_strips(page_size: u32, taken: &[AtlasBlock], shapes: &[[u32; 3]]) -> Result<Vec<AtlasBlock>, Error> {
    let Some(side) = taken.first().map(|block| block.shape[0]).or(shapes.first().map(|shape| shape[0])) else {
        return Ok(Vec::new());
    };
    if let Some(item) = shapes.iter().position(|shape| *shape != [side; 3]) {
        return Err(AtlasError::NotEqualCubes { item, shape: shapes[item], side }.into());
    }
    let width = u64::from(side) * u64::from(side);
    if width > u64::from(page_size) {
        return Err(AtlasError::PageTooSmall { item: 0, shape: [side; 3], page_size, needed: width }.into());
    }
    let rows = page_size / side;
    let mut used: Vec<u64> =
        taken.iter().map(|block| u64::from(block.page) * u64::from(rows) + u64::from(block.corner[1] / side)).collect();
    used.sort_unstable();
    let mut used = used.into_iter().peekable();
    let mut row = 0;
    shapes
        .iter()
        .enumerate()
        .map(|(item, shape)| {
            while used.next_if_eq(&row).is_some() {
                row += 1;
            }
            let (page, row_of_page) = (row / u64::from(rows), row % u64::from(rows));
            row += 1;
            let page = u32::try_from(page).ok().filter(|&page| page < MAX_PAGES);
            let page = page.ok_or(AtlasError::TooManyPages { item, limit: MAX_PAGES })?;
            let corner = [0, row_of_page as u32 * side];
            Ok(AtlasBlock { page, corner, tile: [side; 2], columns: side, gutter: 0, shape: *shape })
        })
        .collect()
}

/// The largest fields come first, each in the wrapping and position that leave the least free area unused.
fn plan_shelves(
    page_size: u32,
    gutter: u32,
    align: u32,
    taken: &[AtlasBlock],
    shapes: &[[u32; 3]],
) -> Result<Vec<AtlasBlock>, Error> {
    let mut pages: Vec<FreeArea> = Vec::new();
    for block in taken {
        while pages.len() <= block.page as usize {
            pages.push(FreeArea::new(page_size, page_size));
        }
        let mut room = block.rectangle();
        room.width = room.width.next_multiple_of(align);
        pages[block.page as usize].take(&room);
    }
    let tile = |shape: &[u32; 3]| [shape[0] + 2 * gutter, shape[1] + 2 * gutter];
    let area = |shape: &[u32; 3]| tile(shape).iter().map(|&n| u64::from(n)).product::<u64>() * u64::from(shape[2]);
    let mut order: Vec<usize> = (0..shapes.len()).collect();
    order.sort_by_key(|&item| std::cmp::Reverse(area(&shapes[item])));

    let mut blocks = vec![AtlasBlock::default(); shapes.len()];
    for item in order {
        let shape = shapes[item];
        let tile = tile(&shape);
        let wraps = wraps(shape[2], tile, page_size, align);
        if wraps.is_empty() {
            let needed = smallest_page(shape[2], tile, align);
            return Err(AtlasError::PageTooSmall { item, shape, page_size, needed }.into());
        }
        let mut page = 0;
        let (columns, place) = loop {
            if page == pages.len() {
                if page >= MAX_PAGES as usize {
                    return Err(AtlasError::TooManyPages { item, limit: MAX_PAGES }.into());
                }
                pages.push(FreeArea::new(page_size, page_size));
            }
            let best = wraps
                .iter()
                .filter_map(|wrap| {
                    let width = (wrap.columns * tile[0]).next_multiple_of(align);
                    let (place, remaining) = pages[page].best_fit(width, wrap.rows * tile[1])?;
                    // Wide blocks keep the texels of a row together in memory.
                    Some(((wrap.unused, remaining, std::cmp::Reverse(wrap.columns)), (wrap.columns, place)))
                })
                .min_by_key(|(score, _)| *score);
            match best {
                Some((_, found)) => break found,
                None => page += 1,
            }
        };
        pages[page].take(&place);
        blocks[item] = AtlasBlock { page: page as u32, corner: [place.x, place.y], tile, columns, gutter, shape };
    }
    Ok(blocks)
}

/// A way to wrap slices over rows.
struct Wrap {
    columns: u32,
    rows: u32,
    /// Number of tiles of the last row without a slice.
    unused: u32,
}

/// All wrappings of `slices` that fit on a page, one for each number of rows.
fn wraps(slices: u32, tile: [u32; 2], page_size: u32, align: u32) -> Vec<Wrap> {
    // A block ends at a multiple of `align` too.
    let most_columns = (page_size / align * align / tile[0]).min(slices);
    let most_rows = (page_size / tile[1]).min(slices);
    let mut found: Vec<Wrap> = Vec::new();
    for rows in 1..=most_rows {
        let columns = slices.div_ceil(rows);
        if columns <= most_columns && slices.div_ceil(columns) == rows {
            found.push(Wrap { columns, rows, unused: columns * rows - slices });
        }
    }
    found
}

/// The smallest page that holds the slices in some wrapping.
fn smallest_page(slices: u32, tile: [u32; 2], align: u32) -> u64 {
    (1..=slices)
        .map(|columns| {
            let width = u64::from(columns) * u64::from(tile[0]);
            width.next_multiple_of(align.into()).max(u64::from(slices.div_ceil(columns)) * u64::from(tile[1]))
        })
        .min()
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shapes() -> impl Strategy<Value = Vec<[u32; 3]>> {
        prop::collection::vec(prop::array::uniform3(1..20u32), 1..30)
    }

    fn assert_apart(blocks: &[AtlasBlock]) {
        for (i, a) in blocks.iter().enumerate() {
            for b in &blocks[..i] {
                assert!(a.page != b.page || !a.rectangle().overlaps(&b.rectangle()), "{a:?} {b:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn blocks_lie_apart_on_their_pages(shapes in shapes(), gutter in 0..3u32, align in 1..5u32) {
            let layout = Layout::Shelves { gutter };
            let blocks = plan(layout, 128, align, &[], &shapes).unwrap();
            let pages = blocks.iter().map(|block| block.page + 1).max().unwrap();
            prop_assert!(blocks.iter().all(|block| block.is_sound(128, pages) && block.corner[0] % align == 0));
            prop_assert!(blocks.iter().zip(&shapes).all(|(block, shape)| block.shape == *shape));
            assert_apart(&blocks);
        }

        #[test]
        fn an_atlas_grows_around_what_is_there(first in shapes(), second in shapes(), removed in any::<prop::sample::Index>()) {
            let layout = Layout::Shelves { gutter: 1 };
            let mut taken = plan(layout, 128, 1, &[], &first).unwrap();
            taken.remove(removed.index(first.len()));
            let added = plan(layout, 128, 1, &taken, &second).unwrap();
            assert_apart(&[taken, added].concat());
        }
    }

    #[test]
    fn strips_fill_a_page_row_by_row() {
        let blocks = plan(Layout::Strips, 4096, 1, &[], &[[64; 3]; 65]).unwrap();
        for (row, block) in blocks.iter().enumerate() {
            assert_eq!((block.page as usize, block.corner), (row / 64, [0, (row % 64 * 64) as u32]));
            assert_eq!(block.slice(5), [5 * 64, block.corner[1]]);
        }
        // A free row is reused before a new one.
        let mut taken = blocks.clone();
        taken.remove(7);
        assert_eq!(plan(Layout::Strips, 4096, 1, &taken, &[[64; 3]; 2]).unwrap()[0], blocks[7]);
        assert_eq!(plan(Layout::Strips, 4096, 1, &taken, &[[64; 3]; 2]).unwrap()[1].corner, [0, 64]);
    }

    #[test]
    fn what_cannot_fit_says_how_large_a_page_would_do() {
        let told = |layout, shapes: &[[u32; 3]]| plan(layout, 64, 1, &[], shapes).unwrap_err().to_string();
        assert_eq!(
            told(Layout::Shelves { gutter: 1 }, &[[4; 3], [20, 30, 40]]),
            "volumes[1]: 20 x 30 x 40 voxels do not fit a page of 64 x 64 texels; page_size must be at least 176"
        );
        assert!(plan(Layout::Shelves { gutter: 1 }, 176, 1, &[], &[[20, 30, 40]]).is_ok());
        assert!(plan(Layout::Shelves { gutter: 1 }, 175, 1, &[], &[[20, 30, 40]]).is_err());
        assert_eq!(
            told(Layout::Strips, &[[9; 3]]),
            "volumes[0]: 9 x 9 x 9 voxels do not fit a page of 64 x 64 texels; page_size must be at least 81"
        );
        assert!(told(Layout::Strips, &[[8; 3], [8, 8, 7]]).starts_with("volumes[1]: strips hold equal cubes"));
    }

    #[test]
    fn unsound_blocks_are_told_apart() {
        let block = plan(Layout::Shelves { gutter: 1 }, 64, 1, &[], &[[5, 6, 7]]).unwrap()[0];
        assert!(block.is_sound(64, 1));
        for wrong in [
            AtlasBlock { page: 1, ..block },
            AtlasBlock { columns: 0, ..block },
            AtlasBlock { columns: u32::MAX, ..block },
            AtlasBlock { corner: [u32::MAX, 0], ..block },
            AtlasBlock { corner: [0, 60], ..block },
            AtlasBlock { shape: [5, 6, u32::MAX], ..block },
            AtlasBlock { shape: [0, 6, 7], ..block },
            AtlasBlock { tile: [8, 8], ..block },
            AtlasBlock { gutter: u32::MAX, ..block },
        ] {
            assert!(!wrong.is_sound(64, 1), "{wrong:?}");
        }
    }
}
