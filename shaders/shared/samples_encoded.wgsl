// Samples stored in any encoding, decoded when they are read. Twin of src/encoding.rs.

struct StoredParams {
    // FLOAT32, FLOAT16, SNORM16 or SNORM8.
    encoding: u32,
    // Distance that the stored value 1 stands for. Halves, and normalised integers as fractions, are multiplied by it.
    scale: f32,
    pad_0: u32,
    pad_1: u32,
}

// Each word holds one sample of 32 bits, two of 16 or four of 8. The first sample is in the lowest bits.
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(7) var<uniform> stored: StoredParams;

// The value of a finite half. The conversion is written out, because devices may read subnormal halves as zero, which
// would count as a hit.
fn half_value(bits: u32) -> f32 {
    let sign = (bits & 0x8000u) << 16u;
    let magnitude = bits & 0x7fffu;
    if magnitude < 0x400u { return bitcast<f32>(sign | bitcast<u32>(f32(magnitude) * HALF_SUBNORMAL)); }
    // Changes the bias of the exponent from 15 to 127.
    return bitcast<f32>(sign | ((magnitude << 13u) + (112u << 23u)));
}

fn stored_sample(index: u32) -> f32 {
    if stored.encoding == FLOAT32 { return bitcast<f32>(words[index]); }
    if stored.encoding == SNORM8 {
        let whole = extractBits(bitcast<i32>(words[index >> 2u]), 8u * (index & 3u), 8u);
        return max(f32(whole) / 127.0, -1.0) * stored.scale;
    }
    let word = words[index >> 1u];
    let first_bit = 16u * (index & 1u);
    if stored.encoding == SNORM16 {
        return max(f32(extractBits(bitcast<i32>(word), first_bit, 16u)) / 32767.0, -1.0) * stored.scale;
    }
    return half_value(extractBits(word, first_bit, 16u)) * stored.scale;
}
