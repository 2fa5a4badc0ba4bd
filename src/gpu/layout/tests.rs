//! The structs against the shaders that read them.

use super::{FILES, StructLayout};
use crate::gpu::tests::source;
use std::collections::HashMap;
use wgpu::naga;

/// Names and offsets of the members of a WGSL struct, and its size.
fn members(module: &naga::Module, name: &str) -> (Vec<(String, usize)>, usize) {
    let found = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name));
    let (_, ty) = found.unwrap_or_else(|| panic!("the kernel has no struct {name}"));
    let naga::TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is not a struct") };
    (members.iter().map(|m| (m.name.clone().unwrap(), m.offset as usize)).collect(), *span as usize)
}

#[test]
fn structs_have_the_layout_that_the_shaders_read() {
    let mut modules = HashMap::new();
    for StructLayout { kernel, name, size, fields } in FILES.iter().copied().flatten() {
        let module =
            modules.entry(*kernel).or_insert_with(|| naga::front::wgsl::parse_str(&source(kernel).unwrap()).unwrap());
        let ours: Vec<_> = fields.iter().map(|&(field, offset)| (field.to_owned(), offset)).collect();
        assert_eq!(members(module, name), (ours, *size), "{name}");
    }
    assert!(FILES.iter().map(|structs| structs.len()).sum::<usize>() >= 33);
}
