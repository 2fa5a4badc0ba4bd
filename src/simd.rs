//! Dispatch to the vector instructions of this machine.

/// Returns the value of a block from the enclosing function, computed with the vector instructions of this machine.
///
/// The block becomes the body of a function with the parameters in parentheses, each with its argument; generic
/// parameters come before them in brackets. It is compiled for the baseline of the target, and on x86-64 also for AVX2.
/// What the block calls must be `#[inline(always)]`, or it stays in its baseline version. A closure could not replace
/// the macro: the compiler may leave a closure with two callers as one function for the baseline.
///
/// Both versions return the same bits, since the compiler fuses no operations.
macro_rules! with_vectors {
    ($([$($generic:tt)*])? ($($name:ident: $kind:ty = $value:expr),* $(,)?) $(-> $result:ty)? $work:block) => {{
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            #[target_feature(enable = "avx2")]
            fn avx2 $(<$($generic)*>)? ($($name: $kind),*) $(-> $result)? $work
            // SAFETY: the processor has AVX2.
            return unsafe { avx2($($value),*) };
        }
        $(let $name: $kind = $value;)*
        $work
    }};
}
pub(crate) use with_vectors;
