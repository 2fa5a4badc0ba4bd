// The fields of a view: one texture of 32-bit words with the samples, and for pictures in motion one filtered texture
// with the dense grids, stacked along z. The table of instances (table.wgsl) has the places of both.

@group(0) @binding(1) var words: texture_2d<u32>;
@group(0) @binding(3) var filtered: texture_3d<f32>;
@group(0) @binding(4) var linear_filter: sampler;

const WIDTH_BITS: u32 = 11u;

const KIND_DENSE: u32 = 0u;
const KIND_SPARSE: u32 = 1u;
const KIND_SHAPE: u32 = 2u;
const KIND_QUADRIC: u32 = 3u;

// An axis on which the direction is smaller than this counts as parallel.
const PARALLEL: f32 = 1e-20;
// Evaluations of a ray at most.
const MAX_STEPS: u32 = 16384u;

// The field that is read at present.
var<private> kind: u32;
var<private> encoding: u32;
var<private> scale: f32;
var<private> first_word: u32;
var<private> shape: vec3u;
var<private> empty_words: u32;
var<private> blocks: vec3u;
var<private> mask_words: u32;
var<private> unit: f32;
var<private> bias: f32;
var<private> structure: u32;
var<private> inverse_lipschitz: f32;
var<private> error_words: u32;
// Texel 22 of its row.
var<private> filter_place: vec4f;
var<private> bricks: Bricks;
var<private> index_words: u32;
var<private> node_words: u32;
// Its level, in the units of its samples.
var<private> level: f32;
// Steps through it.
var<private> steps: u32;

fn word_at(at: u32) -> u32 {
    return textureLoad(words, vec2i(i32(at & ((1u << WIDTH_BITS) - 1u)), i32(at >> WIDTH_BITS)), 0).x;
}

fn select_field(instance: u32) {
    let a = frame_at(instance, 14u);
    let b = frame_at(instance, 15u);
    let c = frame_at(instance, 16u);
    let d = frame_at(instance, 19u);
    kind = u32(a.x);
    encoding = u32(a.y);
    scale = a.z;
    first_word = u32(a.w);
    shape = vec3u(b.xyz);
    empty_words = u32(b.w);
    blocks = vec3u(c.xyz);
    mask_words = u32(c.w);
    unit = d.x;
    bias = d.y;
    structure = u32(d.z);
    inverse_lipschitz = d.w;
    level = view.level.x / unit;
    let step = frame_at(instance, 21u);
    error_words = u32(step.w);
    if IS_MOTION { filter_place = frame_at(instance, 22u); }
    if HAS_SPARSE { select_bricks(instance, step); }
}

fn select_bricks(instance: u32, step: vec4f) {
    let e = frame_at(instance, 20u);
    index_words = u32(e.x);
    node_words = u32(e.y);
    bricks = Bricks(shape, blocks, e.z - level, step.xyz, e.w, 0u, 0u, 0u, 0u);
}

// The sample at a place of the field, less the level.
fn stored_sample(index: u32) -> f32 {
    let stored = select(encoding, u32(ONE_ENCODING), ONE_ENCODING >= 0);
    return decode_sample(word_at(first_word + word_of(index, stored)), index, stored, scale) - level;
}

fn brick_word(at: u32) -> u32 {
    return word_at(index_words + at);
}

fn brick_node(at: u32) -> f32 {
    return bitcast<f32>(word_at(node_words + at));
}

fn empty_bytes(at: u32) -> u32 {
    return word_at(empty_words + at);
}

fn number_at(at: u32) -> f32 {
    return bitcast<f32>(word_at(first_word + at));
}
