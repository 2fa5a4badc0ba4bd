// Makes the beams of the light pass from the faces that the primary pass found, divides the discs of lights that one
// cone does not decide, and collects cones that need a ray past an edge. Twin of `first_beams` and `parts_of_disc` in
// src/scene/lighting/device_beams.rs.

#import scene_view
#import scene_field
#import scene_beam
#import scene_counts

struct SurfaceLight {
    // Unit direction to the light, or its position in scene space.
    place: vec3f,
    // Tangent of half its angle, or its radius in scene units; 0 for hard shadows.
    size: f32,
    is_point: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

struct SurfaceParams {
    eye: vec3f,
    // Number of pixels in a row of the picture.
    width: u32,
    // Scene directions of rays, one unit of depth long: through fragment (0, 0), and the changes to the right and down.
    ray: vec3f,
    // Number of pixels from the start of a row in memory to the start of the next.
    stride: u32,
    ray_x: vec3f,
    light_count: u32,
    ray_y: vec3f,
    bias_voxels: f32,
    // Number of rows of the picture, of tiles in a row, and of tiles.
    height: u32,
    tile_columns: u32,
    tile_count: u32,
    // Distance in the picture between tiles that follow each other, in tiles.
    tile_step: u32,
    lights: array<SurfaceLight, 16>,
}

// Tiles of this dispatch, and parameters of the other kernels, which have only the first two words.
struct TileParams {
    first: u32,
    count: u32,
    // First tile of the next dispatch.
    next: u32,
    // The tile with the first answer in memory.
    start: u32,
    // The tile behind the last one of the submission.
    end: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

@group(0) @binding(1) var<uniform> view: SurfaceParams;
@group(0) @binding(2) var<uniform> piece: TileParams;
@group(0) @binding(7) var<storage, read> seen_pixels: array<vec4u>;
// Three corners and three normals of each face, in the space of the mesh's tree.
@group(0) @binding(8) var<storage, read> faces: array<f32>;
@group(0) @binding(9) var<storage, read_write> beams: array<Beam>;
@group(0) @binding(10) var<storage, read_write> beam_results: array<BeamResult>;
// Numbers of items: see scene_counts.
@group(0) @binding(11) var<storage, read_write> counts: array<atomic<u32>, COUNTS>;
// Output of `divide` and `collect_edges`.
@group(0) @binding(12) var<storage, read_write> parts: array<Beam>;
// Index of the beam of each disc that is divided.
@group(0) @binding(13) var<storage, read_write> discs: array<u32>;
@group(0) @binding(14) var<storage, read> part_results: array<BeamResult>;

const IS_TRIANGLE: u32 = 0xffffffffu;
const FACE_FLOATS: u32 = 18u;

fn vector_at(i: u32) -> vec3f {
    return vec3f(faces[i], faces[i + 1u], faces[i + 2u]);
}

// Cones fill the buffer from its start, rays from its end.
fn add_beam(beam: Beam) {
    if beam.slope > 0.0 {
        let place = atomicAdd(&counts[CONES], 1u);
        beams[place] = beam;
        beams[place].cut = place / CUT_BEAMS;
    } else {
        beams[arrayLength(&beams) - 1u - atomicAdd(&counts[RAYS], 1u)] = beam;
    }
}

// Makes the beams of one tile in each workgroup. Consecutive tiles are far apart in the picture, so that a range of
// them costs about the same as any other. Eight consecutive invocations have 4 x 2 pixels.
@compute @workgroup_size(64)
fn surface_beams(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) lane: u32) {
    begin_invocation(id);
    let tile = piece.first + id.x / GROUP;
    let place = tile % SPREAD * view.tile_step + tile / SPREAD;
    let x = place % view.tile_columns * TILE + (lane & 3u) + ((lane >> 1u) & 4u);
    let y = place / view.tile_columns * TILE + ((lane >> 2u) & 1u) + ((lane >> 3u) & 6u);
    if place >= view.tile_count || x >= view.width || y >= view.height { return; }
    let light_count = view.light_count + zero;
    let first_result = ((tile - piece.start) * GROUP + lane) * light_count;
    for (var k = 0u; k < light_count; k++) { beam_results[first_result + k] = BeamResult(); }
    let seen = seen_pixels[y * view.stride + x];
    if seen.x == 0u || seen.w != IS_TRIANGLE { return; }
    let index = seen.x - 1u;
    let row = seen.z;

    // The hit in the space of the mesh's tree.
    let fragment = vec2f(f32(x), f32(y)) + 0.5;
    let ray = ray_through(row, fragment);
    let along = ray.along;
    let eye = ray.start;
    let first = FACE_FLOATS * (rows[row].first_face + seen.y);
    let a = vector_at(first);
    let ab = vector_at(first + 3u) - a;
    let ac = vector_at(first + 6u) - a;
    let plane = cross(ab, ac);
    let facing = dot(plane, along);
    if facing == 0.0 { return; }
    let t = dot(plane, a - eye) / facing;
    if !(t > 0.0 && t < FAR_T) { return; }
    let from_a = eye - a + t * along;
    let area = dot(plane, plane);
    let u = dot(cross(from_a, ac), plane) / area;
    let v = dot(cross(ab, from_a), plane) / area;
    let scene_ray = view.ray + fragment.x * view.ray_x + fragment.y * view.ray_y;

    let smooth_normal = (1.0 - u - v) * vector_at(first + 9u) + u * vector_at(first + 12u) + v * vector_at(first + 15u);
    var normal = scene_normal(index, smooth_normal) * select(-1.0, 1.0, facing < 0.0);
    // At a silhouette a smooth normal may point away from the eye.
    if !(dot(normal, scene_ray) < 0.0) {
        normal = scene_normal(index, normalize(plane)) * select(-1.0, 1.0, facing < 0.0);
    }

    var beam: Beam;
    beam.p = view.eye + t * scene_ray;
    beam.normal = normalize(normal);
    beam.bias_voxels = view.bias_voxels;
    beam.own = index;
    beam.cut = ROOT;
    for (var i = 0u; i < light_count; i++) {
        let light = view.lights[i];
        beam.direction = light.place;
        beam.t_max = FAR_T;
        beam.slope = light.size;
        if light.is_point != 0u {
            let way = light.place - beam.p;
            beam.t_max = max(length(way), 1e-12);
            beam.direction = way / beam.t_max;
            beam.slope = light.size / beam.t_max;
        }
        beam.owner = first_result + i;
        if dot(beam.normal, beam.direction) > 0.0 { add_beam(beam); }
    }
}

// Collects the discs of lights that one cone does not decide.
@compute @workgroup_size(64)
fn collect_discs(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= piece.count { return; }
    let found = beam_results[beams[id.x].owner];
    if found.is_proven != 0u || found.is_complete != 1u { return; }
    discs[atomicAdd(&counts[DISCS], 1u)] = id.x;
}

// Divides discs into narrow cones.
@compute @workgroup_size(64)
fn divide(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= piece.count { return; }
    let disc = beams[discs[piece.first + id.x]];
    let axes = axes_of(disc.direction);
    var part = disc;
    part.slope = disc.slope / sqrt(f32(PARTS));
    part.is_coarse = 1u;
    for (var i = 0u; i < PARTS; i++) {
        let radius = disc.slope * sqrt((f32(i) + 0.5) / f32(PARTS));
        let angle = f32(i) * GOLDEN_ANGLE;
        let way = disc.direction + radius * (cos(angle) * axes.right + sin(angle) * axes.up);
        part.direction = normalize(way);
        part.t_max = min(disc.t_max * length(way), FAR_T);
        part.owner = PARTS * id.x + i;
        parts[part.owner] = part;
    }
}

// Collects the cones that need a ray past an edge.
@compute @workgroup_size(64)
fn collect_edges(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= piece.count { return; }
    let beam = beams[id.x];
    if beam_results[beam.owner].is_complete == NEEDS_EDGE { parts[atomicAdd(&counts[EDGES], 1u)] = beam; }
}

// Replaces the answers of divided discs by the means of their parts.
@compute @workgroup_size(64)
fn join_parts(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= piece.count { return; }
    let parent = beams[discs[piece.first + id.x]].owner;
    var found = beam_results[parent];
    var sum = 0.0;
    for (var i = 0u; i < PARTS; i++) {
        let part = part_results[PARTS * id.x + i];
        sum += part.value;
        found.steps += part.steps;
        found.is_far += part.is_far;
        if part.is_complete != 1u { found.is_complete = 0u; }
    }
    found.value = sum / f32(PARTS);
    found.is_proven = DIVIDED;
    beam_results[parent] = found;
}
