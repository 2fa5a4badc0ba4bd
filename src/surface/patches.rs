//! Surface patches of one cell: which of its crossed edges bound one sheet of the surface.
//!
//! A cell has 8 corners (bit 0 of the index is x, bit 1 y, bit 2 z), 12 edges and 6 faces.
//!
//! ```text
//!   corner              edge 4 a + u + 2 v              face 2 a + s
//!     6-----7           parallel to axis a;             perpendicular to axis a,
//!    /|    /|           u and v are its position        on the lower (s = 0) or
//!   2-----3 |           on the axes a + 1 and a + 2     the upper side (s = 1)
//!   | 4---|-5           (modulo 3)
//!   |/    |/
//!   0-----1
//! ```
//!
//! An edge is crossed if one end is inside and the other outside. On each face the crossed edges are joined in pairs by
//! segments. A face whose two inside corners lie on a diagonal has four crossed edges and two ways to join them; one
//! bit per face tells whether its inside corners are joined across the face. The segments form closed cycles on the
//! boundary of the cell, and each cycle bounds one patch (Nielson, "Dual Marching Cubes", 2004).

use std::sync::OnceLock;

/// Largest number of patches of a cell: one around each of four corners that share no edge.
pub(crate) const MAX_PATCHES: usize = 4;

/// The patches of a cell: one set of edges per patch, bit `e` for edge `e`. Unused entries are 0.
pub(crate) type Patches = [u16; MAX_PATCHES];

/// The two corners of an edge, the lower one first.
pub(crate) const fn edge_corners(edge: usize) -> [usize; 2] {
    let (axis, u, v) = (edge / 4, edge % 2, edge / 2 % 2);
    let low = u << ((axis + 1) % 3) | v << ((axis + 2) % 3);
    [low, low | 1 << axis]
}

/// Corners of a face in cyclic order.
pub(crate) const fn face_corners(face: usize) -> [usize; 4] {
    let (axis, side) = (face / 2, face % 2);
    let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    let first = side << axis;
    [first, first | u, first | u | v, first | v]
}

/// Edges of a face; entry `i` joins the corners `i` and `i + 1` of [`face_corners`].
pub(crate) const fn face_edges(face: usize) -> [usize; 4] {
    let (axis, side) = (face / 2, face % 2);
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    // The axes after u are v and `axis`, those after v are `axis` and u.
    [4 * u + 2 * side, 4 * v + side + 2, 4 * u + 1 + 2 * side, 4 * v + side]
}

/// Whether both corners of one diagonal of the face are inside and both of the other outside.
pub(crate) fn is_ambiguous(inside: u8, face: usize) -> bool {
    let [a, b, c, d] = face_corners(face);
    let bit = |corner: usize| inside >> corner & 1;
    bit(a) == bit(c) && bit(b) == bit(d) && bit(a) != bit(b)
}

/// The patches of a cell with the corners `inside` (one bit per corner). The inside corners of an ambiguous face are
/// joined if the bit of the face is set in `joined`.
pub(crate) fn patches(inside: u8, joined: u8) -> &'static Patches {
    static TABLE: OnceLock<Vec<Patches>> = OnceLock::new();
    let table = TABLE.get_or_init(|| (0..256 * 64).map(|i| trace((i / 64) as u8, (i % 64) as u8)).collect());
    &table[usize::from(inside) * 64 + usize::from(joined & 63)]
}

/// Follows the segments from face to face until each crossed edge belongs to a cycle.
fn trace(inside: u8, joined: u8) -> Patches {
    // Each crossed edge lies in two faces and is joined to one other edge in each of them.
    let mut links = [[None::<usize>; 2]; 12];
    let mut link = |from: usize, to: usize| {
        let [first, second] = &mut links[from];
        *if first.is_none() { first } else { second } = Some(to);
    };
    for face in 0..6 {
        for (from, to) in segments(inside, joined, face) {
            link(from, to);
            link(to, from);
        }
    }
    let mut patches = [0; MAX_PATCHES];
    let mut count = 0;
    let mut done = 0u16;
    for start in 0..12 {
        if links[start][0].is_none() || done >> start & 1 == 1 {
            continue;
        }
        let mut patch = 0u16;
        let mut edge = start;
        loop {
            patch |= 1 << edge;
            match links[edge].into_iter().flatten().find(|&next| patch >> next & 1 == 0) {
                Some(next) => edge = next,
                None => break,
            }
        }
        done |= patch;
        patches[count] = patch;
        count += 1;
    }
    patches
}

/// The pairs of crossed edges that are joined on a face.
fn segments(inside: u8, joined: u8, face: usize) -> impl Iterator<Item = (usize, usize)> {
    let corners = face_corners(face);
    let edges = face_edges(face);
    let bit = |i: usize| inside >> corners[i] & 1;
    let crossed: Vec<usize> = (0..4).filter(|&i| bit(i) != bit((i + 1) % 4)).map(|i| edges[i]).collect();
    let pairs = match crossed[..] {
        [] => vec![],
        [first, second] => vec![(first, second)],
        _ => {
            // Each segment cuts off one corner: an outside one where the inside corners are joined, else an inside one.
            let cut_off = u8::from(joined >> face & 1 == 0);
            (0..4).filter(|&i| bit(i) == cut_off).map(|i| (edges[(i + 3) % 4], edges[i])).collect()
        }
    };
    pairs.into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crossed(inside: u8) -> u16 {
        (0..12).filter(|&e| edge_corners(e).map(|c| inside >> c & 1).iter().sum::<u8>() == 1).map(|e| 1 << e).sum()
    }

    #[test]
    fn the_edges_of_a_face_join_its_corners_in_order() {
        for face in 0..6 {
            let corners = face_corners(face);
            for (i, edge) in face_edges(face).into_iter().enumerate() {
                let mut ends = [corners[i], corners[(i + 1) % 4]];
                ends.sort_unstable();
                assert_eq!(edge_corners(edge), ends);
            }
        }
    }

    #[test]
    fn patches_divide_the_crossed_edges_and_have_at_least_three_each() {
        for inside in 0..=255u8 {
            for joined in 0..64 {
                let patches = patches(inside, joined);
                let mut union = 0;
                for &patch in patches.iter().filter(|&&patch| patch != 0) {
                    assert!(patch.count_ones() >= 3);
                    assert_eq!(union & patch, 0);
                    union |= patch;
                }
                assert_eq!(union, crossed(inside));
            }
        }
    }

    #[test]
    fn the_complement_has_the_same_patches_if_the_other_corners_are_joined() {
        for inside in 0..=255u8 {
            for joined in 0..64u8 {
                let mut own = *patches(inside, joined);
                let mut other = *patches(!inside, !joined);
                own.sort_unstable();
                other.sort_unstable();
                assert_eq!(own, other);
            }
        }
    }

    #[test]
    fn other_faces_than_ambiguous_ones_do_not_decide() {
        for inside in 0..=255u8 {
            let ambiguous = (0..6).filter(|&face| is_ambiguous(inside, face)).map(|face| 1 << face).sum::<u8>();
            for joined in 0..64u8 {
                assert_eq!(patches(inside, joined), patches(inside, joined & ambiguous));
            }
        }
    }

    #[test]
    fn four_corners_without_a_common_edge_make_four_patches_or_are_joined() {
        assert_eq!(patches(0b0110_1001, 0).iter().filter(|&&patch| patch != 0).count(), 4);
        assert_eq!(patches(0b0110_1001, 63).iter().filter(|&&patch| patch != 0).count(), 4);
        assert_eq!(patches(0b0000_1001, 0)[1..], [patches(0b1000, 0)[0], 0, 0]);
    }
}
