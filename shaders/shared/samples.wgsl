// The samples of a dense field in float32.

@group(0) @binding(1) var<storage, read> distances: array<f32>;

fn stored_sample(index: u32) -> f32 {
    return distances[index];
}
