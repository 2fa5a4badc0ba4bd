// The samples of a dense float32 field.

@group(0) @binding(1) var<storage, read> distances: array<f32>;

fn stored_sample(index: u32) -> f32 {
    return distances[index];
}
