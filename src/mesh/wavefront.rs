//! Reads the triangles of Wavefront OBJ files that have no materials, texture coordinates or colours.
//!
//! Positions keep their order and float64. Polygons are divided into triangles ([`super::polygon`]). An index counts
//! from 1, a negative one from the last vertex before the face. Source: *Object Files (.obj)*, Wavefront, 1993.

use super::polygon::triangulate;
use crate::error::Error;
use crate::memory::space_for;
use crate::progress::Progress;
use glam::DVec3;

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
    // The first face and the number of faces of each polygon with more than three corners.
    let mut polygons: Vec<[usize; 2]> = Vec::new();
    for (number, line) in lines(content).enumerate() {
        if number % LINES == 0 {
            progress.check()?;
        }
        let before = found.faces.len();
        if add(line, &mut found).is_none() {
            return Ok(None);
        }
        if found.faces.len() > before + 1 {
            polygons.push([before, found.faces.len() - before]);
        }
    }
    let vertices = found.vertices.len() as i64;
    let is_complete = found.faces.iter().flatten().all(|corner| (0..vertices).contains(corner));
    if is_complete {
        for [first, count] in polygons {
            divide(&mut found.faces[first..][..count], &found.vertices);
        }
    }
    Ok((is_complete && !found.faces.is_empty()).then_some(found))
}

/// Divides the polygon of a fan again, within its outline.
fn divide(fan: &mut [[i64; 3]], vertices: &[[f64; 3]]) {
    let rows: Vec<i64> = fan[0][..2].iter().copied().chain(fan.iter().map(|face| face[2])).collect();
    let corners: Vec<DVec3> = rows.iter().map(|&row| DVec3::from_array(vertices[row as usize])).collect();
    for (face, triangle) in fan.iter_mut().zip(triangulate(&corners)) {
        *face = triangle.map(|corner| rows[corner]);
    }
}

/// The file with its polygons divided into triangles where a fan would leave their outline; none if there is no such
/// polygon, or a damaged statement. Only lines of positions and of faces are read.
pub(crate) fn with_divided_polygons(content: &[u8], progress: &Progress) -> Result<Option<Vec<u8>>, Error> {
    let mut vertices: Vec<DVec3> = Vec::new();
    // The place of each polygon in the file, and the number of vertices before it.
    let mut polygons: Vec<(usize, &[u8], usize)> = Vec::new();
    let mut start = 0;
    for (number, line) in lines(content).enumerate() {
        if number % LINES == 0 {
            progress.check()?;
        }
        let mut parts = words(line);
        match parts.next() {
            Some(b"v") => {
                let mut number = || std::str::from_utf8(parts.next()?).ok()?.parse::<f64>().ok();
                let (Some(x), Some(y), Some(z)) = (number(), number(), number()) else { return Ok(None) };
                vertices.push(DVec3::new(x, y, z));
            }
            Some(b"f") if line.contains(&b'\\') => return Ok(None),
            Some(b"f") if parts.count() > 3 => polygons.push((start, line, vertices.len())),
            _ => {}
        }
        start += line.len() + 1;
    }
    let (mut divided, mut end) = (Vec::new(), 0);
    for (start, line, before) in polygons {
        let corners: Vec<&[u8]> = words(line).skip(1).collect();
        let place = |corner: &&[u8]| vertices.get(usize::try_from(index(corner, before)?).ok()?).copied();
        let Some(places) = corners.iter().map(place).collect::<Option<Vec<DVec3>>>() else { return Ok(None) };
        let triangles = triangulate(&places);
        if triangles.iter().all(|triangle| triangle[0] == 0) {
            continue;
        }
        divided.extend_from_slice(&content[end..start]);
        for [a, b, c] in triangles {
            divided.extend_from_slice(b"f ");
            divided.extend_from_slice(&[corners[a], corners[b], corners[c]].join(&b' '));
            divided.push(b'\n');
        }
        end = start + line.len();
    }
    if divided.is_empty() {
        return Ok(None);
    }
    divided.extend_from_slice(&content[end..]);
    Ok(Some(divided))
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
