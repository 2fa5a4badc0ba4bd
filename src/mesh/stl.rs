//! The records of binary STL files.

use super::Mesh;
use glam::DVec3;
use rayon::prelude::*;

/// Bytes of a face: its normal and three corners, float32, and an attribute of two bytes.
const RECORD: usize = 50;

/// Number of faces that one task writes.
const CHUNK: usize = 4096;

impl Mesh {
    /// The records of at most `count` faces from the face `first` on. A face without a normal in float64 has zero.
    pub fn stl_records(&self, first: usize, count: usize) -> Vec<u8> {
        let faces = self.faces.get(first..).unwrap_or_default();
        let faces = &faces[..faces.len().min(count)];
        let mut records = vec![0; faces.len() * RECORD];
        records.par_chunks_mut(CHUNK * RECORD).zip(faces.par_chunks(CHUNK)).for_each(|(records, faces)| {
            for (record, face) in records.chunks_exact_mut(RECORD).zip(faces) {
                let [a, b, c] = face.map(|corner| DVec3::from_array(self.world[corner as usize]));
                let numbers = [unit((b - a).cross(c - a)), a, b, c].map(|row| row.as_vec3().to_array());
                let bytes = record.chunks_exact_mut(4).zip(numbers.into_iter().flatten());
                bytes.for_each(|(bytes, number)| bytes.copy_from_slice(&number.to_le_bytes()));
            }
        });
        records
    }
}

/// The vector at length 1; zero if it is zero or not finite.
fn unit(vector: DVec3) -> DVec3 {
    if !vector.is_finite() {
        return DVec3::ZERO;
    }
    // Division by the largest component first keeps the squares in range.
    let largest = vector.abs().max_element();
    let scaled = vector / if largest == 0.0 { 1.0 } else { largest };
    let length = scaled.length();
    scaled / if length == 0.0 { 1.0 } else { length }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_have_unit_normals_and_the_corners_of_their_faces() {
        let vertices = [[0.0; 3], [2e-30, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.25]];
        let mesh = Mesh::new(&vertices, &[[0, 2, 1], [0, 3, 2]]).unwrap();
        let records = mesh.stl_records(0, 10);
        let numbers: Vec<f32> =
            records[..48].chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();
        assert_eq!(records.len(), mesh.faces().len() * RECORD);
        assert_eq!(numbers.len(), 12);
        assert_eq!(numbers[..3].iter().map(|x| x * x).sum::<f32>(), 1.0);
        assert_eq!(mesh.stl_records(0, 1), records[..RECORD]);
        assert!(mesh.stl_records(mesh.faces().len(), 1).is_empty() && mesh.stl_records(9, 1).is_empty());
    }

    #[test]
    fn short_vectors_have_unit_length() {
        assert_eq!(unit(DVec3::new(0.0, -3e-200, 0.0)), DVec3::NEG_Y);
        assert_eq!(unit(DVec3::ZERO), DVec3::ZERO);
        assert_eq!(unit(DVec3::new(0.0, f64::INFINITY, 1.0)), DVec3::ZERO);
    }
}
