//! Stored samples as array elements, one type for each encoding.

use crate::encoding::Encoding;
use bytemuck::Pod;
use half::f16;

/// A stored sample.
pub trait Texel: Pod + Send + Sync + 'static {
    /// The encoding of samples of this type.
    const ENCODING: Encoding;

    /// `value` rounded toward zero; `scale` as for [`Encoding::encode`].
    fn encode(value: f32, scale: f32) -> Self;

    /// The distance of a sample; `scale` as for [`Encoding::decode`].
    fn decode(self, scale: f32) -> f32;

    /// Whether the decoded value is above zero, without decoding.
    fn is_above_zero(self) -> bool;
}

impl Texel for f32 {
    const ENCODING: Encoding = Encoding::Float32;

    #[inline]
    fn encode(value: f32, _: f32) -> Self {
        value
    }

    #[inline]
    fn decode(self, _: f32) -> f32 {
        self
    }

    #[inline]
    fn is_above_zero(self) -> bool {
        self > 0.0
    }
}

/// Implements `Texel` for an integer of as many bits as the encoding, or for a type made of one.
macro_rules! impl_texel {
    ($texel:ty, $encoding:ident, $bits:ty, $from_bits:expr, $to_bits:expr) => {
        impl Texel for $texel {
            const ENCODING: Encoding = Encoding::$encoding;

            #[inline]
            fn encode(value: f32, scale: f32) -> Self {
                $from_bits(Self::ENCODING.encode(value, scale) as $bits)
            }

            #[inline]
            fn decode(self, scale: f32) -> f32 {
                let bits: $bits = $to_bits(self);
                Self::ENCODING.decode(u32::from(bits), scale)
            }

            #[inline]
            fn is_above_zero(self) -> bool {
                // A half has its sign in the same bit as an integer.
                let bits: $bits = $to_bits(self);
                bits.cast_signed() > 0
            }
        }
    };
}

impl_texel!(f16, Float16, u16, f16::from_bits, f16::to_bits);
impl_texel!(i16, Snorm16, u16, u16::cast_signed, i16::cast_unsigned);
impl_texel!(i8, Snorm8, u8, u8::cast_signed, i8::cast_unsigned);
