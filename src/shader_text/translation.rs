//! Translation of WGSL texts to other shading languages by naga.

use crate::error::{ArgumentError, choice};
use naga::back::{glsl, hlsl, msl};
use naga::compact::{KeepUnused, compact};
use naga::proc::BoundsCheckPolicies;
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{AddressSpace, GlobalVariable, Module, ResourceBinding, ShaderStage, TypeInner, front};

/// A shading language.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Language {
    Wgsl,
    Glsl,
    Hlsl,
    Msl,
}

impl Language {
    /// Converts the public name of a language.
    pub(crate) fn from_name(name: &str) -> Result<Self, ArgumentError> {
        choice(
            "language",
            name,
            &[("wgsl", Self::Wgsl), ("glsl", Self::Glsl), ("hlsl", Self::Hlsl), ("msl", Self::Msl)],
        )
    }
}

/// Options of GLSL, which has one entry point per text.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GlslTarget {
    pub version: glsl::Version,
    pub stage: ShaderStage,
    pub entry_point: &'static str,
}

/// Translates a WGSL text.
pub(crate) fn translate(wgsl: &str, language: Language, target: GlslTarget) -> Result<String, ArgumentError> {
    if language == Language::Wgsl {
        return Ok(wgsl.to_owned());
    }
    let (module, info) = parse(wgsl)?;
    write(&module, &info, language, target)
}

/// A WGSL text in another language, without the items that its entry points do not use.
pub(crate) fn translate_used(wgsl: &str, language: Language, target: GlslTarget) -> Result<String, ArgumentError> {
    if language == Language::Wgsl {
        return Ok(wgsl.to_owned());
    }
    let (mut module, _) = parse(wgsl)?;
    compact(&mut module, KeepUnused::No);
    let info = validated(&module, wgsl)?;
    write(&module, &info, language, target)
}

fn write(module: &Module, info: &ModuleInfo, language: Language, target: GlslTarget) -> Result<String, ArgumentError> {
    let mut text = String::new();
    match language {
        Language::Wgsl => unreachable!("WGSL needs no writer"),
        Language::Glsl => {
            let binding_map = resources(module).map(|(binding, _)| (binding, binding.binding as u8)).collect();
            let options = glsl::Options { version: target.version, binding_map, ..glsl::Options::default() };
            let pipeline = glsl::PipelineOptions {
                shader_stage: target.stage,
                entry_point: target.entry_point.into(),
                multiview: None,
            };
            let policies = BoundsCheckPolicies::default();
            glsl::Writer::new(&mut text, module, info, &options, &pipeline, policies)
                .and_then(|mut writer| writer.write())
                .map_err(|error| refused(&error.to_string()))?;
        }
        Language::Hlsl => {
            let options = hlsl::Options { fake_missing_bindings: true, ..hlsl::Options::default() };
            hlsl::Writer::new(&mut text, &options, &hlsl::PipelineOptions::default())
                .write(module, info, None)
                .map_err(|error| refused(&error.to_string()))?;
        }
        Language::Msl => {
            let options = msl_options(module);
            (text, _) = msl::write_string(module, info, &options, &msl::PipelineOptions::default())
                .map_err(|error| refused(&error.to_string()))?;
        }
    }
    Ok(text)
}

/// The variables of a module that a program binds, and their bindings.
pub(crate) fn resources(module: &Module) -> impl Iterator<Item = (ResourceBinding, &GlobalVariable)> {
    module.global_variables.iter().filter_map(|(_, variable)| Some((variable.binding?, variable)))
}

/// Metal has separate tables for buffers, textures and samplers: each resource has the index of its WGSL binding there.
/// The sizes of buffers are passed in one more buffer, after the last.
fn msl_options(module: &Module) -> msl::Options {
    let mut entry = msl::EntryPointResources::default();
    let mut next_buffer = 0;
    for (binding, variable) in resources(module) {
        let slot = binding.binding as u8;
        let is_buffer = matches!(variable.space, AddressSpace::Uniform | AddressSpace::Storage { .. });
        let is_sampler = matches!(module.types[variable.ty].inner, TypeInner::Sampler { .. });
        let target = msl::BindTarget {
            buffer: is_buffer.then_some(slot),
            sampler: is_sampler.then_some(msl::BindSamplerTarget::Resource(slot)),
            texture: (!is_buffer && !is_sampler).then_some(slot),
            mutable: is_buffer,
            ..msl::BindTarget::default()
        };
        if is_buffer {
            next_buffer = next_buffer.max(slot + 1);
        }
        entry.resources.insert(binding, target);
    }
    entry.sizes_buffer = Some(next_buffer);
    let per_entry_point_map = module.entry_points.iter().map(|point| (point.name.clone(), entry.clone())).collect();
    msl::Options { per_entry_point_map, fake_missing_bindings: false, ..msl::Options::default() }
}

/// Parses and validates a WGSL text for every device.
pub(crate) fn parse(wgsl: &str) -> Result<(Module, ModuleInfo), ArgumentError> {
    let module = front::wgsl::parse_str(wgsl).map_err(|error| refused(&error.emit_to_string(wgsl)))?;
    let info = validated(&module, wgsl)?;
    Ok((module, info))
}

/// Types and uniformity of the expressions of a module that is valid on every device.
fn validated(module: &Module, wgsl: &str) -> Result<ModuleInfo, ArgumentError> {
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(module)
        .map_err(|error| refused(&error.emit_to_string(wgsl)))
}

/// A generated text that naga refuses is a defect of fieldbake, and the message says so.
fn refused(reason: &str) -> ArgumentError {
    ArgumentError::new("language", format!("the shader could not be translated: {reason}"))
}
