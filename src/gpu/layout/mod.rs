//! Structs that Rust and WGSL share. Each is the twin of the WGSL struct of the same name.
//!
//! Fields are ordered so that no padding is needed: a scalar follows each three-component vector. The macro
//! `gpu_structs!` declares the structs of a file and registers their layouts. A test parses the WGSL and compares
//! names, offsets and sizes.

/// Declares structs, each after the name of a kernel that reads it, and the list `LAYOUTS` of their layouts.
macro_rules! gpu_structs {
    ($(
        $(#[$doc:meta])*
        $kernel:literal: struct $name:ident {
            $($(#[$field_doc:meta])* $field:ident: $type:ty,)*
        }
    )*) => {
        $(
            $(#[$doc])*
            #[derive(Debug, Clone, Copy, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
            #[repr(C)]
            pub(crate) struct $name {
                $($(#[$field_doc])* pub(crate) $field: $type,)*
            }
        )*

        #[cfg(test)]
        pub(super) const LAYOUTS: &[super::StructLayout] = &[$(super::StructLayout {
            kernel: $kernel,
            name: stringify!($name),
            size: size_of::<$name>(),
            fields: &[$((stringify!($field), std::mem::offset_of!($name, $field))),*],
        }),*];
    };
}

/// The layout of a struct, for the test that compares it with the kernel's.
#[cfg(test)]
struct StructLayout {
    kernel: &'static str,
    name: &'static str,
    size: usize,
    /// Names and offsets in bytes.
    fields: &'static [(&'static str, usize)],
}

/// Declares the files of this folder and the list of all layouts in them.
macro_rules! files {
    ($($file:ident),*) => {
        $(
            mod $file;
            pub(crate) use $file::*;
        )*

        #[cfg(test)]
        const FILES: &[&[StructLayout]] = &[$($file::LAYOUTS),*];
    };
}
files!(bake, merge, picture, scene, surfaces);

#[cfg(test)]
mod tests;
