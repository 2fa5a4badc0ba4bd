// Samples stored in any encoding, decoded when they are read.

#import decode

struct StoredParams {
    // FLOAT32, FLOAT16, SNORM16 or SNORM8.
    encoding: u32,
    // Distance that the stored value 1 stands for. Halves, and normalised integers as fractions, are multiplied by it.
    scale: f32,
    pad_0: u32,
    pad_1: u32,
}

@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(7) var<uniform> stored: StoredParams;

fn stored_sample(index: u32) -> f32 {
    return decode_sample(words[word_of(index, stored.encoding)], index, stored.encoding, stored.scale);
}
