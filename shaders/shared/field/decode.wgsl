// Stored samples in any encoding, from the word that holds them. Twin of src/encoding.rs.
//
// A word has four samples of 8 bits, two of 16 or one of 32, the first in the lowest bits.

// The value of a finite half. It is decoded by hand, because devices may flush the smallest halves to zero, and a zero
// would be a hit.
fn half_value(bits: u32) -> f32 {
    let sign = (bits & 0x8000u) << 16u;
    let magnitude = bits & 0x7fffu;
    if magnitude < 0x400u { return bitcast<f32>(sign | bitcast<u32>(f32(magnitude) * HALF_SUBNORMAL)); }
    // The bias of the exponent changes from 15 to 127.
    return bitcast<f32>(sign | ((magnitude << 13u) + (112u << 23u)));
}

// `count` bits of a word from bit `first` on, as a signed integer. Shifts replace bitfieldExtract, which GLSL ES 3.00
// does not have.
fn signed_bits(word: u32, first: u32, count: u32) -> i32 {
    return bitcast<i32>(word << (32u - count - first)) >> (32u - count);
}

// Index of the word that holds a sample.
fn word_of(index: u32, encoding: u32) -> u32 {
    if encoding == FLOAT32 { return index; }
    return select(index >> 1u, index >> 2u, encoding == SNORM8);
}

// The distance of a sample. A half, or the fraction that a normalised integer stands for, is multiplied by `scale`.
fn decode_sample(word: u32, index: u32, encoding: u32, scale: f32) -> f32 {
    if encoding == FLOAT32 { return bitcast<f32>(word); }
    if encoding == SNORM8 {
        return max(f32(signed_bits(word, 8u * (index & 3u), 8u)) / 127.0, -1.0) * scale;
    }
    let first_bit = 16u * (index & 1u);
    if encoding == SNORM16 { return max(f32(signed_bits(word, first_bit, 16u)) / 32767.0, -1.0) * scale; }
    return half_value((word >> first_bit) & 0xffffu) * scale;
}
