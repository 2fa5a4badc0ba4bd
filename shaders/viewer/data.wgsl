// The fields of a view: one texture of 32-bit words with the samples, one texture of numbers, which has a row for each
// instance, and for pictures in motion one filtered texture with the dense grids, stacked along z.
//
// Row of an instance, texels of four floats. Indices count words and are below 2^24, so that floats have them exactly.
//
//     texel 0-2   start of the rays: of the middle, what one unit to the right and up on the plane at depth 1 adds.
//                 The fourth number of texel 0 is the depth of the start.
//           3-5   their direction, one unit of depth long: likewise
//           6-8   field from scene, rows of 3 x 4
//           9-11  scene from field
//           12    colour, strength of the highlight
//           13    emission, sharpness of the highlight
//           14    kind, encoding, scale, first sample
//           15    voxels (3), bytes of empty space
//           16    blocks or bricks (3), masks of cells
//           17    lower corner in field space (3), flags
//           18    upper corner (3), object
//           19    world units of a distance of 1, bias of shadow rays, structure, 1 / Lipschitz constant
//           20    index of bricks, nodes, floor, longest step
//           21    node step (3), errors of the samples (bytes)
//           22    place in the filtered texture: first layer, texels per voxel, distance of 1.0, one over the
//                 difference between neighbouring samples that 1 % of the pairs exceed
//           23    share of the view's largest error at a byte of 255
//
// Row `count` has the rays of scene space. The rows after it are lights: direction or position in scene space with 0 or 1,
// then the colour.

struct View {
    // Width and height of the picture, pixels; side of a pixel at depth 1; number of instances.
    size: vec4f,
    background: vec4f,
    // Ambient light, strength of ground light (hemisphere) or 1, number of lights, kind of picture.
    light: vec4f,
    // Level of the surface, distance of iso-lines, range of colours, largest number of steps: world units.
    level: vec4f,
    // Slice plane in scene space: points with dot(xyz, p) = w; xyz zero for none.
    slice: vec4f,
    // Box of the slice, scene space.
    slice_lower: vec4f,
    slice_upper: vec4f,
    // World units of a scene unit; 1 cuts the half of the slice on the side of the eye away; two unused numbers.
    scene: vec4f,
    // One over the size of the filtered texture; one unused number.
    filtered: vec4f,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var words: texture_2d<u32>;
@group(0) @binding(2) var frames: texture_2d<f32>;
@group(0) @binding(3) var filtered: texture_3d<f32>;
@group(0) @binding(4) var linear_filter: sampler;

const WIDTH_BITS: u32 = 11u;

const KIND_DENSE: u32 = 0u;
const KIND_SPARSE: u32 = 1u;
const KIND_SHAPE: u32 = 2u;
const KIND_QUADRIC: u32 = 3u;

const FLAG_VISIBLE: u32 = 1u;
const FLAG_CASTS: u32 = 2u;
const FLAG_UNLIT: u32 = 4u;

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

fn frame_at(row: u32, texel: u32) -> vec4f {
    return textureLoad(frames, vec2i(i32(texel), i32(row)), 0);
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
