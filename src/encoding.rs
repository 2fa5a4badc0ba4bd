//! Storage of one signed distance in 32, 16 or 8 bits.
//!
//! # Theory
//!
//! Sphere tracing requires that a stored magnitude never exceeds the true distance. Every encoding therefore rounds
//! *toward zero*: the magnitude of the decoded value is at most the magnitude of the original, and its sign is the same
//! unless it is zero.
//!
//! | encoding | stored | range | error, at most |
//! |---|---|---|---|
//! | float32 | the value | all | 0 |
//! | float16 | value / scale | 65504 scale | 2^-10 of the value, 2^-24 scale below 2^-14 scale |
//! | snorm16 | value / scale * 32767 | scale | scale / 32767 |
//! | snorm8 | value / scale * 127 | scale | scale / 127 |
//!
//! Values outside the range are stored as its end, which is a lower bound on the distance. [`Encoding::scale`] derives
//! the scale from the voxel, so the error has the same bound in voxels for a mesh of any size:
//!
//! | encoding | scale, world units | error in voxels, at most |
//! |---|---|---|
//! | float32 | 1 | 0 |
//! | float16 | largest power of two up to the voxel's longest side | 2^-10 of the distance, or 2^-24 |
//! | snorm16 | half width of the band around the surface | band / 32767 |
//! | snorm8 | half width of the band around the surface | band / 127 |
//!
//! Division by a power of two leaves the mantissa of a half unchanged. Texture hardware has the same normalised
//! formats: a sampler of an R8 or R16 snorm texture returns `value / scale`, and so does one of an R16 float texture.
//!
//! # Practice
//!
//! Encoding a decoded value gives the same bits. [`Encoding::encode`] and [`Encoding::decode`] are the definition; the
//! functions for slices compute the same values faster.

use crate::error::{ArgumentError, choice};
use crate::simd::with_vectors;
use half::f16;
use half::slice::HalfFloatSliceExt;

/// A format for stored distances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Encoding {
    /// 32-bit floats, world units.
    #[default]
    Float32,
    /// 16-bit floats.
    Float16,
    /// Signed 16-bit integers.
    Snorm16,
    /// Signed 8-bit integers.
    Snorm8,
}

/// Largest magnitude of an 8-bit and of a 16-bit normalised integer. The most negative integer is not used.
const SNORM8_STEPS: f32 = 127.0;
const SNORM16_STEPS: f32 = 32767.0;
/// Relative amount by which a quotient is reduced, so that its rounding never exceeds the exact quotient. It is less
/// than one step: 13 ulps of 32767 are 1/40.
const QUOTIENT_SHARE: f32 = 1.0 - 4.0 * f32::EPSILON;
/// 1.5 * 2^23. In a sum with it the last bit of an f32 has the value one, so the sum rounds to a whole number. (`floor`
/// is a function call on baseline processors, and a cast has special cases.)
const WHOLE: f32 = 12_582_912.0;
/// Relative error of a truncated half: one step of its 11 significant bits.
const HALF_EPSILON: f32 = 1.0 / 1024.0;
/// The largest half and its bits, and the smallest normal half.
const HALF_LARGEST: f32 = 65504.0;
const HALF_LARGEST_BITS: u32 = 0x7bff;
const HALF_NORMAL: f32 = 1.0 / (1u32 << 14) as f32;
const TWO_TO_112: f32 = f32::from_bits((127 + 112) << 23);
/// Spacing of halves below 2^-14, which are evenly spaced.
pub const HALF_SUBNORMAL: f32 = 1.0 / (1u32 << 24) as f32;
/// Range of the exponents of the scales of float16: every half times the scale is a finite f32 without rounding.
const HALF_SCALE_EXPONENTS: std::ops::RangeInclusive<i32> = -125..=111;
/// Largest scale of a normalised encoding: the largest valid coordinate.
const LARGEST_SCALE: f64 = 1e37;

impl Encoding {
    /// Converts the public name of an encoding.
    pub fn from_name(name: &str) -> Result<Self, ArgumentError> {
        choice("encoding", name, &Self::ALL.map(|encoding| (encoding.name(), encoding)))
    }

    /// All encodings.
    pub const ALL: [Self; 4] = [Self::Float32, Self::Float16, Self::Snorm16, Self::Snorm8];

    /// The public name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Float32 => "float32",
            Self::Float16 => "float16",
            Self::Snorm16 => "snorm16",
            Self::Snorm8 => "snorm8",
        }
    }

    /// Number of bytes of a stored value.
    pub fn bytes(self) -> usize {
        match self {
            Self::Float32 => 4,
            Self::Float16 | Self::Snorm16 => 2,
            Self::Snorm8 => 1,
        }
    }

    /// Whether values are integers that divide the range from `-scale` to `scale` evenly.
    pub fn is_normalised(self) -> bool {
        matches!(self, Self::Snorm16 | Self::Snorm8)
    }

    /// Whether stored values are multiplied by a scale: for all encodings but float32.
    pub fn is_scaled(self) -> bool {
        self != Self::Float32
    }

    /// The scale for a field. `voxel` is the longest side of a voxel, and distances up to `band` are represented; both
    /// are positive lengths in world units.
    pub fn scale(self, voxel: f64, band: f64) -> f32 {
        match self {
            Self::Float32 => 1.0,
            Self::Float16 => {
                // The exponent of an f64 is the exponent of the largest power of two up to the voxel.
                let exponent = (voxel.to_bits() >> 52 & 0x7ff) as i32 - 1023;
                power_of_two(exponent.clamp(*HALF_SCALE_EXPONENTS.start(), *HALF_SCALE_EXPONENTS.end()))
            }
            Self::Snorm16 | Self::Snorm8 => (band.min(LARGEST_SCALE) as f32).max(f32::MIN_POSITIVE),
        }
    }

    /// The bits of a value, in the low [`Encoding::bytes`] bytes, rounded toward zero. `scale` must be positive, and
    /// for float16 a power of two; see [`Encoding::check_scale`].
    #[inline]
    pub fn encode(self, value: f32, scale: f32) -> u32 {
        match self {
            Self::Float32 => value.to_bits(),
            Self::Float16 => u32::from(half_toward_zero(value * scale.recip())),
            Self::Snorm16 => u32::from(snorm_toward_zero(value, scale, SNORM16_STEPS) as u16),
            Self::Snorm8 => u32::from(snorm_toward_zero(value, scale, SNORM8_STEPS) as u8),
        }
    }

    /// Decodes stored bits.
    #[inline]
    pub fn decode(self, bits: u32, scale: f32) -> f32 {
        match self {
            Self::Float32 => f32::from_bits(bits),
            Self::Float16 => half_value(bits) * scale,
            Self::Snorm16 => snorm_value(f32::from(bits as u16 as i16), scale, SNORM16_STEPS),
            Self::Snorm8 => snorm_value(f32::from(bits as u8 as i8), scale, SNORM8_STEPS),
        }
    }

    /// Fails unless every nonzero stored value decodes to a finite nonzero value of the same sign.
    pub fn check_scale(self, scale: f32) -> Result<(), ArgumentError> {
        let is_positive = scale.is_finite() && scale > 0.0;
        let expected = match self {
            Self::Float16 if is_positive && !is_half_scale(scale) => {
                let (least, most) = (HALF_SCALE_EXPONENTS.start(), HALF_SCALE_EXPONENTS.end());
                format!("a power of two from 2^{least} to 2^{most} for float16")
            }
            Self::Snorm16 | Self::Snorm8 if is_positive && self.decode(1, scale) == 0.0 => {
                format!("large enough that its steps as {} are above zero", self.name())
            }
            _ if is_positive => return Ok(()),
            _ => "a positive number".to_owned(),
        };
        Err(ArgumentError::new("scale", format!("must be {expected}, got {scale}")))
    }

    /// Largest error of a decoded value, for values within the range whose magnitude is at most `magnitude`.
    pub fn error_bound(self, magnitude: f32, scale: f32) -> f32 {
        // Decoding a normalised value rounds twice in f32; below 2^-126 each rounding is off by up to 2^-150.
        let step = |steps: f32| scale / steps + 2.0 * f32::EPSILON * scale + f32::from_bits(1);
        match self {
            Self::Float32 => 0.0,
            Self::Float16 => (magnitude * HALF_EPSILON).max(HALF_SUBNORMAL * scale),
            Self::Snorm16 => step(SNORM16_STEPS),
            Self::Snorm8 => step(SNORM8_STEPS),
        }
    }

    /// Encodes a slice into native-endian bytes. `out` must have [`Encoding::bytes`] per value and be aligned to them.
    pub fn encode_slice(self, values: &[f32], scale: f32, out: &mut [u8]) {
        with_vectors!((encoding: Encoding = self, values: &[f32] = values, scale: f32 = scale, out: &mut [u8] = out) {
            encoding.encode_each(values, scale, out)
        })
    }

    #[inline(always)]
    fn encode_each(self, values: &[f32], scale: f32, out: &mut [u8]) {
        match self {
            Self::Float32 => out.copy_from_slice(bytemuck::cast_slice(values)),
            Self::Float16 => {
                let per_scale = scale.recip();
                for (bits, &value) in bytemuck::cast_slice_mut::<_, u16>(out).iter_mut().zip(values) {
                    *bits = half_toward_zero(value * per_scale);
                }
            }
            Self::Snorm16 => {
                for (bits, &value) in bytemuck::cast_slice_mut::<_, i16>(out).iter_mut().zip(values) {
                    *bits = snorm_toward_zero(value, scale, SNORM16_STEPS) as i16;
                }
            }
            Self::Snorm8 => {
                for (bits, &value) in bytemuck::cast_slice_mut::<_, i8>(out).iter_mut().zip(values) {
                    *bits = snorm_toward_zero(value, scale, SNORM8_STEPS) as i8;
                }
            }
        }
    }

    /// Decodes the output of [`Encoding::encode_slice`].
    pub fn decode_slice(self, bytes: &[u8], scale: f32, out: &mut [f32]) {
        match self {
            Self::Float32 => out.copy_from_slice(bytemuck::cast_slice(bytes)),
            Self::Float16 => {
                let halves: &[f16] =
                    half::slice::HalfBitsSliceExt::reinterpret_cast(bytemuck::cast_slice::<_, u16>(bytes));
                halves.convert_to_f32_slice(out);
                out.iter_mut().for_each(|value| *value *= scale);
            }
            Self::Snorm16 => {
                for (value, &bits) in out.iter_mut().zip(bytemuck::cast_slice::<_, i16>(bytes)) {
                    *value = snorm_value(f32::from(bits), scale, SNORM16_STEPS);
                }
            }
            Self::Snorm8 => {
                for (value, &bits) in out.iter_mut().zip(bytemuck::cast_slice::<_, i8>(bytes)) {
                    *value = snorm_value(f32::from(bits), scale, SNORM8_STEPS);
                }
            }
        }
    }
}

/// An f32 with this exponent, from -126 to 127.
fn power_of_two(exponent: i32) -> f32 {
    f32::from_bits(((exponent + 127) as u32) << 23)
}

/// Whether this is a valid scale of float16.
fn is_half_scale(scale: f32) -> bool {
    let exponent = (scale.to_bits() >> 23) as i32 - 127;
    HALF_SCALE_EXPONENTS.contains(&exponent) && power_of_two(exponent) == scale
}

/// The value of a half. `f16::to_f32` would detect the features of the processor at each call.
#[inline]
fn half_value(bits: u32) -> f32 {
    // An exact product changes the bias of the exponent from 15 to 127, for subnormal halves below 2^-14 too.
    let magnitude = f32::from_bits((bits & 0x7fff) << 13) * TWO_TO_112;
    // Infinities and NaN keep their exponent of ones.
    let special = if bits & 0x7c00 == 0x7c00 { 0x7f80_0000 } else { 0 };
    f32::from_bits(magnitude.to_bits() | special | (bits & 0x8000) << 16)
}

/// The value that a texture sampler returns for a normalised integer, times the scale. The most negative integer counts
/// as -1.
#[inline]
fn snorm_value(stored: f32, scale: f32, steps: f32) -> f32 {
    (stored / steps).max(-1.0) * scale
}

/// The normalised integer for `value`, rounded toward zero by its decoded value.
///
/// The quotient, slightly reduced and rounded down, is that integer or the one before it. Decoding the next integer
/// decides.
#[inline(always)]
fn snorm_toward_zero(value: f32, scale: f32, steps: f32) -> i32 {
    let magnitude = value.abs();
    let quotient = magnitude / scale * (steps * QUOTIENT_SHARE);
    let quotient = if quotient < steps { quotient } else { steps };
    // A tie may round down by one. The comparison below corrects it.
    let guess = (quotient - 0.5 + WHOLE) - WHOLE;
    let above = if guess < steps { guess + 1.0 } else { steps };
    let stored = if snorm_value(above, scale, steps) <= magnitude { above } else { guess };
    let whole = (stored + WHOLE).to_bits() as i32 - WHOLE.to_bits() as i32;
    if value < 0.0 { -whole } else { whole }
}

/// The half for `value`, rounded toward zero.
#[inline(always)]
fn half_toward_zero(value: f32) -> u16 {
    let bits = value.to_bits();
    let (sign, magnitude_bits) = (bits >> 16 & 0x8000, bits & 0x7fff_ffff);
    let magnitude = f32::from_bits(magnitude_bits);
    // The exponent decreases by 112. The last 13 bits of the mantissa do not exist in a half.
    let cut = magnitude_bits.wrapping_sub(112 << 23) >> 13;
    let normal = if magnitude < HALF_LARGEST { cut } else { HALF_LARGEST_BITS };
    // Below 2^-14 halves are evenly spaced, as are the floats from 1/2 on. A sum that was rounded up is decremented.
    let sum = magnitude + 0.5;
    let even = sum.to_bits().wrapping_sub(0.5f32.to_bits()).wrapping_sub(u32::from(sum - 0.5 > magnitude));
    (sign | if magnitude < HALF_NORMAL { even } else { normal }) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SCALES: [f32; 6] = [1.0, 0.1, 3.0, 1e-20, 7e12, 0.3];

    /// A valid scale of the encoding near this one.
    fn scale_near(encoding: Encoding, scale: f32) -> f32 {
        if encoding == Encoding::Float16 { encoding.scale(scale.into(), 1.0) } else { scale }
    }

    fn round_trip(encoding: Encoding, value: f32, scale: f32) -> f32 {
        encoding.decode(encoding.encode(value, scale), scale)
    }

    #[test]
    fn names_are_taken_back_and_others_refused() {
        for encoding in Encoding::ALL {
            assert_eq!(Encoding::from_name(encoding.name()), Ok(encoding));
        }
        let told = Encoding::from_name("uint8").unwrap_err().to_string();
        assert_eq!(told, "encoding: must be one of \"float32\", \"float16\", \"snorm16\", \"snorm8\", got \"uint8\"");
    }

    #[test]
    fn every_stored_number_comes_back_as_itself() {
        for encoding in [Encoding::Float16, Encoding::Snorm16, Encoding::Snorm8] {
            for scale in SCALES.map(|scale| scale_near(encoding, scale)) {
                for bits in 0..1u32 << (8 * encoding.bytes()) {
                    let value = encoding.decode(bits, scale);
                    // Infinities, the unused integer, and the negative zero of integers are excluded.
                    let stored = encoding.encode(value, scale);
                    if value.is_finite() && !(encoding.is_normalised() && bits == 1 << (8 * encoding.bytes() - 1)) {
                        assert_eq!(stored, bits, "{encoding:?} {scale} {value}");
                    }
                }
            }
        }
    }

    /// The definition: no larger integer decodes to a magnitude within the magnitude of the value.
    fn check_snorm(value: f32, scale: f32, steps: f32) {
        let stored = snorm_toward_zero(value, scale, steps);
        let decoded = |whole: i32| snorm_value(whole as f32, scale, steps);
        assert!(decoded(stored.abs()) <= value.abs(), "{value} / {scale} in {steps}: {stored}");
        assert!(stored.abs() == steps as i32 || decoded(stored.abs() + 1) > value.abs(), "{value} / {scale}: {stored}");
        assert!(stored == 0 || (stored < 0) == (value < 0.0));
    }

    #[test]
    fn normalised_integers_are_the_largest_within_the_value() {
        for scale in [1.0, 0.3, 7e12, 1e-20, f32::MIN_POSITIVE, 1e38] {
            for steps in [SNORM8_STEPS, SNORM16_STEPS] {
                for whole in 0..=steps as u32 {
                    // At a stored value, and just beside it.
                    let at = snorm_value(whole as f32, scale, steps);
                    for value in [at, at.next_down().max(0.0), at.next_up()] {
                        check_snorm(value, scale, steps);
                        check_snorm(-value, scale, steps);
                    }
                }
            }
        }
    }

    #[test]
    fn halves_are_cut_at_every_exponent() {
        // Every exponent and sign, and mantissas on both sides of each half's.
        for high in 0..=u16::MAX {
            for low in [0, 1, 0x0fff, 0x1000, 0x1fff, 0x2000, 0xffff] {
                let value = f32::from_bits(u32::from(high) << 16 | low);
                if value.is_finite() {
                    let stored = half_toward_zero(value);
                    let [back, next] = [stored, stored + 1].map(|bits| f16::from_bits(bits).to_f32());
                    assert!(back.abs() <= value.abs() && back.is_sign_negative() == value.is_sign_negative());
                    assert!(next.abs() > value.abs() || stored & 0x7fff == 0x7bff, "{value} became {back}");
                }
            }
        }
    }

    #[test]
    fn halves_are_those_of_the_standard() {
        for bits in 0..=u16::MAX {
            let (value, expected) = (Encoding::Float16.decode(u32::from(bits), 1.0), f16::from_bits(bits).to_f32());
            assert!(value.to_bits() == expected.to_bits() || value.is_nan() && expected.is_nan(), "{bits:x}: {value}");
        }
    }

    #[test]
    fn a_scale_too_small_to_be_cut_in_steps_is_refused() {
        assert!(Encoding::Snorm16.check_scale(1e-30).is_ok());
        assert!(Encoding::Float32.check_scale(1e-45).is_ok());
        for scale in [2f32.powi(-125), 0.5, 1.0, 2f32.powi(111)] {
            assert!(Encoding::Float16.check_scale(scale).is_ok());
        }
        for scale in [2f32.powi(-126), 0.3, 3.0, 2f32.powi(112)] {
            let told = Encoding::Float16.check_scale(scale).unwrap_err().to_string();
            assert!(told.starts_with("scale: must be a power of two from 2^-125 to 2^111"), "{told}");
        }
        let told = Encoding::Snorm8.check_scale(1e-45).unwrap_err().to_string();
        assert!(told.contains("steps as snorm8"), "{told}");
        for scale in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            for encoding in Encoding::ALL {
                let told = encoding.check_scale(scale).unwrap_err().to_string();
                assert!(told.starts_with("scale: must be a positive number, got"), "{told}");
            }
        }
    }

    #[test]
    fn every_voxel_has_a_scale_that_is_accepted_and_keeps_the_voxel() {
        for exponent in -1074..=1023 {
            for voxel in [2f64.powi(exponent), 1.999 * 2f64.powi(exponent), 1.001 * 2f64.powi(exponent)] {
                for encoding in Encoding::ALL {
                    let scale = encoding.scale(voxel, 4.0 * voxel);
                    encoding.check_scale(scale).unwrap();
                    if (-125..=111).contains(&exponent) {
                        let stored = encoding.decode(encoding.encode(voxel as f32, scale), scale);
                        let error = (f64::from(stored) - f64::from(voxel as f32)).abs();
                        assert!(error <= 0.04 * voxel, "{encoding:?} {voxel:e}: {error:e}");
                    }
                }
                let scale = f64::from(Encoding::Float16.scale(voxel, 1.0));
                assert!(!(-125..=111).contains(&exponent) || scale <= voxel && voxel < 2.0 * scale);
            }
        }
    }

    #[test]
    fn halves_are_the_same_bits_at_every_scale() {
        // These values are exact at all of these scales, so only the scale differs.
        for exponent in [-100, -3, 0, 7, 100] {
            let scale = power_of_two(exponent);
            for high in 0..=u16::MAX {
                let value = f32::from_bits(u32::from(high) << 16 | 0x1fff);
                let scaled = value * scale;
                if value.is_finite() && scaled.is_finite() && scaled / scale == value && scaled.is_normal() {
                    let bits = Encoding::Float16.encode(scaled, scale);
                    assert_eq!(bits, Encoding::Float16.encode(value, 1.0), "{value} at 2^{exponent}");
                    assert_eq!(Encoding::Float16.decode(bits, scale), Encoding::Float16.decode(bits, 1.0) * scale);
                }
            }
        }
    }

    #[test]
    fn what_is_out_of_range_becomes_its_end() {
        assert_eq!(round_trip(Encoding::Float16, 1e9, 1.0), 65504.0);
        assert_eq!(round_trip(Encoding::Float16, -65519.0, 1.0), -65504.0);
        assert_eq!(round_trip(Encoding::Float16, -1e9, 0.25), -65504.0 / 4.0);
        assert_eq!(round_trip(Encoding::Snorm8, 5.0, 0.5), 0.5);
        assert_eq!(round_trip(Encoding::Snorm16, -5.0, 0.5), -0.5);
    }

    proptest! {
        #[test]
        fn rounding_is_toward_zero_and_within_the_bound(mantissa in -2.0..2.0f32, exponent in -30..14i32, which in 0..6usize) {
            for encoding in Encoding::ALL {
                let scale = scale_near(encoding, SCALES[which]);
                let value = if encoding.is_normalised() { mantissa * scale } else { mantissa * 2f32.powi(exponent) * scale };
                let back = round_trip(encoding, value, scale);
                prop_assert!(back.abs() <= value.abs(), "{encoding:?}: {value} became {back}");
                prop_assert!(back == 0.0 || back.signum() == value.signum());
                if !encoding.is_normalised() || value.abs() <= scale {
                    prop_assert!((back - value).abs() <= encoding.error_bound(value.abs(), scale));
                }
            }
        }

        #[test]
        fn slices_are_encoded_as_their_values(values in prop::collection::vec(-3.0..3.0f32, 0..40)) {
            for encoding in Encoding::ALL {
                // A buffer aligned for every encoding.
                let mut words = vec![0u32; values.len()];
                let bytes = &mut bytemuck::cast_slice_mut(&mut words)[..values.len() * encoding.bytes()];
                encoding.encode_slice(&values, 2.0, bytes);
                let mut back = vec![0.0; values.len()];
                encoding.decode_slice(bytes, 2.0, &mut back);
                let expected: Vec<f32> = values.iter().map(|&value| round_trip(encoding, value, 2.0)).collect();
                prop_assert_eq!(back, expected);
            }
        }
    }
}
