//! Services that need no adapter are always tested. The other tests print the reason when they are skipped.

use super::context::{Context, check_adapter};
use super::device::{Place, choose};
use super::shader::{KERNELS, shared, source_instead};
use crate::csg::evaluation::leaf::kernel_texts;
use crate::encoding::Encoding;
use crate::error::{DeviceError, Error};
use crate::progress::Progress;
use std::sync::Arc;
use wgpu::naga;

/// The adapter for tests, or None with the reason printed. With `FIELDBAKE_REQUIRE_GPU=1` a missing adapter is a
/// failure.
pub(crate) fn test_context() -> Option<Arc<Context>> {
    match choose("gpu") {
        Ok(Place::Gpu(context)) => Some(context),
        Ok(Place::Cpu) => unreachable!("\"gpu\" is never the CPU"),
        Err(reason) if std::env::var("FIELDBAKE_REQUIRE_GPU").is_ok_and(|value| value == "1") => {
            panic!("FIELDBAKE_REQUIRE_GPU is set: {reason}")
        }
        Err(reason) => {
            eprintln!("skipped: {reason}");
            None
        }
    }
}

#[test]
fn every_kernel_parses_and_validates() {
    for (name, _) in KERNELS {
        validate(name, &source(name).unwrap());
    }
}

/// The whole text of a kernel, with the modules that the layers above write.
pub(crate) fn source(kernel: &str) -> Result<String, String> {
    source_instead(kernel, &kernel_texts())
}

/// Fails unless a text is a valid shader.
pub(crate) fn validate(name: &str, text: &str) {
    let module = naga::front::wgsl::parse_str(text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(text)));
    // `pack2x16float` is part of WebGPU; naga lists it as a capability because of old OpenGL.
    let core = naga::valid::Capabilities::SHADER_FLOAT16_IN_FLOAT32;
    let mut validator = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), core);
    validator.validate(&module).unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(text)));
}

#[test]
fn imports_are_joined_once_and_unknown_names_are_told() {
    let text = source("bake_distance").unwrap();
    assert_eq!(text.matches("struct Triangle {").count(), 1);
    assert!(text.find("struct Triangle {").unwrap() < text.find("fn nearest_triangle").unwrap());
    assert_eq!(source("bake_everything").unwrap_err(), "there is no kernel 'bake_everything'");
}

#[test]
fn an_adapter_that_lacks_something_is_refused_with_the_reason() {
    let limits = wgpu::Limits::default();
    assert_eq!(check_adapter(true, &limits), Ok(()));
    assert_eq!(check_adapter(false, &limits), Err("it has no compute shaders with indirect dispatches".into()));
    let few = wgpu::Limits { max_storage_buffers_per_shader_stage: 4, ..limits };
    assert_eq!(check_adapter(true, &few), Err("it allows 4 storage buffers per shader stage, 8 are needed".into()));
}

#[test]
fn unknown_devices_are_named() {
    assert!(matches!(choose("abacus"), Err(DeviceError::Unknown { requested }) if requested == "abacus"));
    assert!(matches!(choose("cpu"), Ok(Place::Cpu)));
}

#[test]
fn data_goes_up_and_comes_back() {
    let Some(context) = test_context() else { return };
    let items: Vec<u32> = (0..1000).collect();
    let buffer = context.upload("items", &items).unwrap();
    let mut back = vec![0u32; 1000];
    context.read("items", &buffer, &mut back, &Progress::new()).unwrap();
    assert_eq!(items, back);
}

#[test]
fn a_buffer_past_the_limit_is_refused_with_its_size() {
    let Some(context) = test_context() else { return };
    let limit = context.max_binding();
    match context.storage("a field", limit + 4) {
        Err(DeviceError::TooLarge { needed, limit: told, .. }) => assert_eq!((needed, told), (limit + 4, limit)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_shader_that_does_not_compile_is_an_error_with_its_reason() {
    let Some(context) = test_context() else { return };
    match context.compile("broken", "main", "@compute @workgroup_size(1) fn main() { let x = nothing; }") {
        Err(DeviceError::Shader { kernel, reason, .. }) => {
            assert_eq!(kernel, "broken");
            assert!(reason.contains("nothing"), "{reason}");
        }
        other => panic!("{other:?}"),
    }
    match context.compile("empty", "start", "@compute @workgroup_size(1) fn main() {}") {
        Err(DeviceError::Shader { reason, .. }) => assert!(reason.contains("start"), "{reason}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_cancelled_job_stops_waiting() {
    let Some(context) = test_context() else { return };
    let buffer = context.upload("items", &[0u32; 16]).unwrap();
    let progress = Progress::new();
    progress.cancel();
    let outcome = context.read("items", &buffer, &mut [0u32; 16], &progress);
    assert_eq!(outcome, Err(Error::Cancelled));
    // The context still works.
    context.read("items", &buffer, &mut [0u32; 16], &Progress::new()).unwrap();
}

#[test]
fn a_lost_device_is_an_error_and_the_next_one_works() {
    let Some(context) = test_context() else { return };
    // Separate devices, because the shared one serves other tests at the same time.
    let first = Context::open(&context.info).unwrap();
    let buffer = first.upload("items", &[7u32; 16]).unwrap();
    first.destroy();
    let error = first.read("items", &buffer, &mut [0u32; 16], &Progress::new()).unwrap_err();
    assert!(matches!(error, Error::Device(DeviceError::Lost { .. })), "{error}");
    assert!(first.upload("more", &[0u32]).is_err());

    let second = Context::open(&context.info).unwrap();
    let buffer = second.upload("items", &[7u32; 16]).unwrap();
    let mut back = [0u32; 16];
    second.read("items", &buffer, &mut back, &Progress::new()).unwrap();
    assert_eq!(back, [7; 16]);
}

#[test]
fn a_device_decodes_every_stored_number_as_the_core_does() {
    let Some(context) = test_context() else { return };
    for encoding in [Encoding::Float16, Encoding::Snorm16, Encoding::Snorm8] {
        let scale = 0.3;
        let text = format!(
            "{}
            @group(0) @binding(1) var<storage, read> stored: array<u32>;
            @group(0) @binding(2) var<storage, read_write> decoded: array<f32>;
            @compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3u) {{
                let encoding = {}u;
                decoded[id.x] = decode_sample(stored[word_of(id.x, encoding)], id.x, encoding, {scale});
            }}",
            shared("decode").unwrap(),
            encoding as u32
        );
        let kernel = context.compile("decode", "main", &text).unwrap();
        let stored: Vec<u32> = (0..1u32 << (8 * encoding.bytes()))
            // Infinities and NaN are refused earlier.
            .map(|bits| if encoding == Encoding::Float16 && bits & 0x7c00 == 0x7c00 { 0 } else { bits })
            .collect();
        let bytes: Vec<u8> = stored.iter().flat_map(|bits| bits.to_le_bytes()[..encoding.bytes()].to_vec()).collect();
        // The numbers of each encoding fill whole words.
        let words: Vec<u32> = bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
        let words = context.upload("stored", &words).unwrap();
        let decoded = context.storage("decoded", 4 * stored.len() as u64).unwrap();
        let group = context.bind("decode", &kernel, &[(1, &words), (2, &decoded)]).unwrap();
        context.dispatch("decode", &kernel, &group, [stored.len() as u32 / 64, 1, 1]).unwrap();
        let mut values = vec![0.0f32; stored.len()];
        context.read("decoded", &decoded, &mut values, &Progress::new()).unwrap();
        for (bits, value) in stored.into_iter().zip(values) {
            let expected = encoding.decode(bits, scale);
            // Halves are decoded by shifts alone. The others have a quotient within 2.5 ulp (WGSL) and a product.
            let allowed = if encoding == Encoding::Float16 { 0.0 } else { 3.5 * f32::EPSILON * expected.abs() };
            assert!((value - expected).abs() <= allowed, "{encoding:?} {bits:x}: {value}, expected {expected}");
        }
    }
}
