// Computes the texels of an atlas from the samples of a field. One invocation computes one texel of a slice, gutter
// included. Twin of src/atlas/texels.rs and src/encoding.rs, bit for bit.
//
// The kernel handles samples as bit patterns, because devices may flush small floats to zero. A half is made by
// subtracting the exponent of the scale and shifting out mantissa bits. A normalised integer is found by comparison
// with the table `levels`, which the CPU computed.

struct PackParams {
    // First texel (x, y) of the block, and size of a slice including its gutters, in texels.
    corner: vec2u,
    tile: vec2u,
    shape: vec3u,
    gutter: u32,
    columns: u32,
    // First slice, and number of slices, of the part of the field that is bound.
    first_plane: u32,
    planes: u32,
    // Number of words in a row of the page.
    row_words: u32,
    // Number of texels in a word: 1 for float32, 2 for 16 bits, 4 for 8 bits.
    word_texels: u32,
    // Largest normalised integer (32767 or 127); 0 for floats.
    steps: u32,
    scale: f32,
    // Binary exponent of the scale of float16, which is a power of two.
    scale_exponent: i32,
}

@group(0) @binding(0) var<storage, read> params: PackParams;
@group(0) @binding(1) var<storage, read> samples: array<u32>;
// The page. It is zero before the first field is packed. Neighbouring slices may share a word.
@group(0) @binding(2) var<storage, read_write> page: array<atomic<u32>>;
// Magnitude that each normalised integer from 0 to `steps` stands for, in the units of the samples.
@group(0) @binding(3) var<storage, read> levels: array<f32>;

// Bits of the half for a sample divided by the scale, rounded toward zero: the low bits of the mantissa are dropped.
fn half_bits(bits: u32) -> u32 {
    let sign = (bits >> 16u) & 0x8000u;
    var exponent = i32((bits >> 23u) & 0xffu);
    var mantissa = bits & 0x7fffffu;
    if exponent == 0 {
        if mantissa == 0u { return sign; }
        // A subnormal float: its leading bit moves to the place of the implied bit of a normal float.
        let shift = 23u - firstLeadingBit(mantissa);
        mantissa = (mantissa << shift) & 0x7fffffu;
        exponent = 1 - i32(shift);
    }
    exponent -= params.scale_exponent;
    if exponent >= 143 { return sign | 0x7bffu; }  // 65536 and more: the largest half
    if exponent >= 113 { return sign | (u32(exponent - 112) << 10u) | (mantissa >> 13u); }
    if exponent < 102 { return sign; }
    // Below 2^-14 halves are evenly spaced by 2^-24.
    return sign | ((mantissa | 0x800000u) >> u32(126 - exponent));
}

// Largest number of corrections to the guessed integer. The quotient is off by a few ulps.
const MAX_CORRECTIONS: u32 = 8u;

// The normalised integer of a sample, rounded toward zero: the largest magnitude that does not exceed the sample's.
fn snorm_bits(bits: u32) -> u32 {
    let magnitude = bitcast<f32>(bits & 0x7fffffffu);
    let share = min(magnitude / params.scale, 1.0);
    var stored = min(u32(share * f32(params.steps)), params.steps);
    for (var i = 0u; i < MAX_CORRECTIONS; i++) {
        if stored > 0u && levels[stored] > magnitude { stored--; } else { break; }
    }
    for (var i = 0u; i < MAX_CORRECTIONS; i++) {
        if stored < params.steps && levels[stored + 1u] <= magnitude { stored++; } else { break; }
    }
    return select(stored, 0u - stored, (bits >> 31u) == 1u);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    // A workgroup computes 64 texels of one row of a slice.
    let column = group.x * 64u + local.x;
    if column >= params.tile.x { return; }
    let plane = group.z;
    let z = params.first_plane + plane;
    let last = params.shape - 1u;
    let x = min(max(column, params.gutter) - params.gutter, last.x);
    let y = min(max(group.y, params.gutter) - params.gutter, last.y);
    let bits = samples[x + params.shape.x * (y + params.shape.y * plane)];

    let tile = vec2u(z % params.columns, z / params.columns) * params.tile;
    let texel = params.corner + tile + vec2u(column, group.y);
    let word = texel.y * params.row_words + texel.x / params.word_texels;
    if params.word_texels == 1u {
        atomicStore(&page[word], bits);
        return;
    }
    var stored = 0u;
    if params.steps == 0u { stored = half_bits(bits); } else { stored = snorm_bits(bits); }
    let width = 32u / params.word_texels;
    let mask = (1u << width) - 1u;
    atomicOr(&page[word], (stored & mask) << (width * (texel.x % params.word_texels)));
}
