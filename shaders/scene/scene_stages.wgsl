// Sizes of the dispatches of a light pass, from numbers that earlier dispatches counted. Each kernel has one
// invocation, and each of the other dispatches has workgroups of 64 invocations.

#import scene_counts
#import scene_beam

@group(0) @binding(0) var<storage, read_write> counts: array<u32, COUNTS>;
// Number of workgroups of each stage along x, y and z, and an unused word.
@group(0) @binding(1) var<storage, read_write> groups: array<vec4u, STAGES>;
// Parameters of each stage, which begin with the first item and the number of items.
@group(0) @binding(2) var<storage, read_write> params: array<u32>;

fn set_stage(stage: u32, first: u32, count: u32) {
    params[STRIDE * stage] = first;
    params[STRIDE * stage + 1u] = count;
    groups[stage] = vec4u((count + GROUP - 1u) / GROUP, 1u, 1u, 0u);
}

// Starts the next tiles of pixels: see `TileParams` in scene_surfaces.wgsl.
@compute @workgroup_size(1)
fn next_tiles() {
    const TILES: u32 = STRIDE * STAGE_TILES;
    let first = params[TILES + 2u];
    let count = min(params[TILES + 1u], params[TILES + 4u] - first);
    params[TILES] = first;
    params[TILES + 2u] = first + count;
    groups[STAGE_TILES] = vec4u(count, 1u, 1u, 0u);
    for (var i = 0u; i < BEAMS_FIT; i++) { counts[i] = 0u; }
}

// Sizes of the stages that evaluate cones and rays. Rays fill the buffer from its end.
@compute @workgroup_size(1)
fn count_beams() {
    set_stage(STAGE_CONES, 0u, counts[CONES]);
    set_stage(STAGE_CUTS, 0u, (counts[CONES] + CUT_BEAMS - 1u) / CUT_BEAMS);
    params[STRIDE * STAGE_CUTS + 2u] = counts[CONES];
    set_stage(STAGE_RAYS, counts[BEAMS_FIT] - counts[RAYS], counts[RAYS]);
}

// Sizes of the next round of divided discs.
@compute @workgroup_size(1)
fn next_discs() {
    let first = counts[FIRST_DISC];
    let count = min(counts[DISCS] - first, counts[DISCS_FIT]);
    counts[FIRST_DISC] = first + count;
    counts[EDGES] = 0u;
    set_stage(STAGE_DISCS, first, count);
    set_stage(STAGE_PARTS, 0u, PARTS * count);
}

@compute @workgroup_size(1)
fn count_edges() {
    set_stage(STAGE_EDGES, 0u, counts[EDGES]);
}
