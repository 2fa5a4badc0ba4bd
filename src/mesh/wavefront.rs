//! Reads the triangles of Wavefront OBJ files that have no materials, texture coordinates or colours.
//!
//! Positions keep their order and float64. A polygon becomes a fan of triangles from its first corner. An index counts
//! from 1, a negative one from the last vertex before the face. Source: *Object Files (.obj)*, Wavefront, 1993.

use crate::error::Error;
use crate::memory::space_for;
use crate::progress::Progress;

/// Positions, and faces as triples of indices.
pub(crate) struct Triangles {
    pub vertices: Vec<[f64; 3]>,
    pub faces: Vec<[i64; 3]>,
}

/// Number of lines between two checks for an interruption.
const LINES: usize = 1 << 15;

/// Reads a file; None if it has a statement that needs a full reader, or one that is damaged.
pub(crate) fn read(content: &[u8], progress: &Progress) -> Result<Option<Triangles>, Error> {
    // A backslash joins two lines.
    if content.contains(&b'\\') {
        return Ok(None);
    }
    let Some([vertices, faces]) = counts(content, progress)? else {
        return Ok(None);
    };
    let mut found = Triangles { vertices: space_for("vertices", vertices)?, faces: space_for("faces", faces)? };
    for (number, line) in lines(content).enumerate() {
        if number % LINES == 0 {
            progress.check()?;
        }
        if add(line, &mut found).is_none() {
            return Ok(None);
        }
    }
    let vertices = found.vertices.len() as i64;
    let is_complete = found.faces.iter().flatten().all(|corner| (0..vertices).contains(corner));
    Ok((is_complete && !found.faces.is_empty()).then_some(found))
}

fn lines(content: &[u8]) -> impl Iterator<Item = &[u8]> {
    content.split(|&byte| byte == b'\n' || byte == b'\r')
}

/// Numbers of vertices and of triangles; None if there is a statement that needs a full reader.
fn counts(content: &[u8], progress: &Progress) -> Result<Option<[usize; 2]>, Error> {
    let [mut vertices, mut triangles] = [0, 0];
    for (number, line) in lines(content).enumerate() {
        if number % LINES == 0 {
            progress.check()?;
        }
        let mut words = words(line);
        match words.next() {
            Some(b"v") => vertices += 1,
            Some(b"f") => triangles += words.count().saturating_sub(2),
            None | Some(b"vn" | b"o" | b"g" | b"s") => {}
            Some(word) if word[0] == b'#' => {}
            Some(_) => return Ok(None),
        }
    }
    Ok(Some([vertices, triangles]))
}

fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|byte| byte.is_ascii_whitespace()).filter(|word| !word.is_empty())
}

/// Adds the vertex or the face of a line; None if the line is damaged, or has a colour.
fn add(line: &[u8], found: &mut Triangles) -> Option<()> {
    let mut words = words(line);
    match words.next() {
        Some(b"v") => {
            let mut number = || std::str::from_utf8(words.next()?).ok()?.parse().ok();
            found.vertices.push([number()?, number()?, number()?]);
            // The weight of a rational curve may follow.
            (words.count() <= 1).then_some(())
        }
        Some(b"f") => {
            let mut corner = || words.next().map(|word| index(word, found.vertices.len()));
            let [first, mut second] = [corner()??, corner()??];
            let mut third = corner()??;
            loop {
                found.faces.push([first, second, third]);
                second = third;
                third = match corner() {
                    Some(next) => next?,
                    None => return Some(()),
                };
            }
        }
        _ => Some(()),
    }
}

/// The vertex of the corner `v`, `v/vt`, `v//vn` or `v/vt/vn` of a face, counted from 0.
fn index(corner: &[u8], vertices: usize) -> Option<i64> {
    let digits = corner.split(|&byte| byte == b'/').next()?;
    let number: i64 = std::str::from_utf8(digits).ok()?.parse().ok()?;
    match number {
        0 => None,
        1.. => Some(number - 1),
        _ => (vertices as i64).checked_add(number),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faces(text: &str) -> Option<Vec<[i64; 3]>> {
        read(text.as_bytes(), &Progress::new()).unwrap().map(|found| found.faces)
    }

    #[test]
    fn polygons_become_fans_and_indices_count_from_either_end() {
        let square = "v 0 0 0\nv 1 0 0\r\nv 1 1 0 1\n v\t0 1e0 -0.5\n";
        let found = read(format!("{square}f 1 2 3 4").as_bytes(), &Progress::new()).unwrap().unwrap();
        assert_eq!(found.vertices, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, -0.5]]);
        assert_eq!(found.faces, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(faces(&format!("# a\no b\ng c\ns off\n{square}vn 0 0 1\nf -4//1 2//1 -1//1")).unwrap(), [[0, 1, 3]]);
        assert_eq!(faces(&format!("{square}f -2 -1 1\nv 0 0 9\nf -2 -1 1")).unwrap(), [[2, 3, 0], [3, 4, 0]]);
    }

    #[test]
    fn other_statements_and_damaged_ones_are_left_to_a_full_reader() {
        let start = "v 0 0 0\nv 1 0 0\nv 1 1 0\n";
        assert!(faces(&format!("{start}f 1 2 3")).is_some());
        for line in [
            "",
            "f 1 2",
            "f 1 2 4",
            "f 0 1 2",
            "f 1 2 -4",
            "f 1 2 x",
            "f 1 2 3\nvt 0 0",
            "f 1 2 3\nusemtl a",
            "f 1 2 \\\n3",
            "f 1 2 3\nv 0 0",
            "f 1 2 3\nv 0 0 0 1 1 1",
            "f 1 2 3\nv 0 0 a",
            "f 1 2 3\nmtllib a.mtl",
            "f 1 2 3\ncurv 1",
            "f 1 2 99999999999999999999",
        ] {
            assert!(faces(&format!("{start}{line}")).is_none(), "{line}");
        }
    }
}
