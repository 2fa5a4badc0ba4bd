// Finds the triangle that each pixel shows. Shading follows later, for the visible face of each pixel only. This pass
// evaluates only the conditions of visibility: the side of the face and the alpha mask of its texture. Twin of
// `test_triangles` in src/scene/visibility/pixel_ray.rs.

#import scene_view

struct RasterMaterial {
    // 0: not drawn by this pass. 1: opaque. 2: drawn where the alpha mask is above the cutoff.
    kind: u32,
    two_sided: u32,
    cutoff: f32,
    // Factor for the opacity of the texture.
    opacity: f32,
    // First mip level of the texture, and number of levels; 0 without a texture.
    first_level: u32,
    levels: u32,
    pad_0: u32,
    pad_1: u32,
}

struct TextureLevel {
    first: u32,
    width: u32,
    height: u32,
    pad_0: u32,
}

@group(0) @binding(1) var<storage, read> positions: array<f32>;
@group(0) @binding(2) var<storage, read> corners: array<u32>;
@group(0) @binding(3) var<storage, read> coordinates: array<vec2f>;
@group(0) @binding(4) var<storage, read> face_materials: array<u32>;
@group(0) @binding(5) var<storage, read> materials: array<RasterMaterial>;
@group(0) @binding(6) var<storage, read> texture_levels: array<TextureLevel>;
@group(0) @binding(7) var<storage, read> texels: array<u32>;

// The fourth word of a pixel that shows a face; fields have their number of steps there.
const IS_TRIANGLE: u32 = 0xffffffffu;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat) row: u32,
    @location(1) @interpolate(flat) face: u32,
    @location(2) uv: vec2f,
}

fn vertex_position(vertex: u32) -> vec3f {
    return vec3f(positions[3u * vertex], positions[3u * vertex + 1u], positions[3u * vertex + 2u]);
}

@vertex
fn triangle_corner(@builtin(vertex_index) corner: u32, @builtin(instance_index) row: u32) -> Corner {
    let vertex = corners[corner];
    return Corner(clip_position(row, vertex_position(vertex)), row, corner / 3u, coordinates[vertex]);
}

fn opacity_at(level: TextureLevel, uv: vec2f) -> f32 {
    let size = vec2f(f32(level.width), f32(level.height));
    let wrapped = uv - floor(uv);
    let p = vec2f(wrapped.x, 1.0 - wrapped.y) * size - 0.5;
    let cell = floor(p);
    let f = p - cell;
    var line: vec2f;
    for (var dy = 0; dy < 2; dy++) {
        // The first texel of a cell is at most one before the start of the row or column.
        let y = u32(i32(cell.y) + dy + i32(level.height)) % level.height;
        let left = u32(i32(cell.x) + i32(level.width)) % level.width;
        let right = u32(i32(cell.x) + 1 + i32(level.width)) % level.width;
        let first = level.first + level.width * y;
        line[dy] = mix(f32(texels[first + left] >> 24u), f32(texels[first + right] >> 24u), f.x) / 255.0;
    }
    return mix(line.x, line.y, f.y);
}

// Opacity of a material's texture. `footprint` is the side of the area that the pixel covers, in texture widths.
fn texture_opacity(material: RasterMaterial, uv: vec2f, footprint: f32) -> f32 {
    let base = texture_levels[material.first_level];
    let covered = footprint * f32(max(base.width, base.height));
    let level = clamp(log2(max(covered, 1.0)), 0.0, f32(material.levels - 1u));
    let low = floor(level);
    let near = opacity_at(texture_levels[material.first_level + u32(low)], uv);
    if level == low { return near; }
    return mix(near, opacity_at(texture_levels[material.first_level + u32(low) + 1u], uv), level - low);
}

// Side of the area that a pixel covers on a face, in texture widths.
fn footprint_on(corner: Corner) -> f32 {
    let first = 3u * corner.face;
    let vertices = vec3u(corners[first], corners[first + 1u], corners[first + 2u]);
    let a = vertex_position(vertices.x);
    let normal = cross(vertex_position(vertices.y) - a, vertex_position(vertices.z) - a);
    let area = length(normal);
    let uv_a = coordinates[vertices.x];
    let uv_ab = coordinates[vertices.y] - uv_a;
    let uv_ac = coordinates[vertices.z] - uv_a;
    let density = sqrt(abs(uv_ab.x * uv_ac.y - uv_ab.y * uv_ac.x) / max(area, 1e-30));
    let along = ray_through(corner.row, corner.position.xy).along;
    let slant = max(abs(dot(normal, along)) / max(area * length(along), 1e-30), 0.05);
    // Side of the pixel at this depth, in the mesh's own space. `position.w` is 1 / w.
    var aside = (corner.position.xy - rows[corner.row].middle) * rows[corner.row].pixel;
    if rows[corner.row].is_parallel != 0u { aside = vec2f(0.0); }
    let pixel = rows[corner.row].pixel / corner.position.w * length(along) / sqrt(1.0 + dot(aside, aside));
    return pixel / sqrt(slant) * density;
}

@fragment
fn triangle_seen(corner: Corner, @builtin(front_facing) is_front: bool) -> @location(0) vec4u {
    let row = corner.row;
    let material = materials[rows[row].first_material + face_materials[corner.face]];
    if material.kind == 0u { discard; }
    if material.two_sided == 0u && is_front == (rows[row].is_mirrored != 0u) { discard; }
    if material.kind == 2u {
        var opacity = material.opacity;
        if material.levels > 0u {
            opacity *= texture_opacity(material, corner.uv, footprint_on(corner));
        }
        if opacity < material.cutoff { discard; }
    }
    // Index of the instance + 1, face of its mesh, row, mark.
    return vec4u(rows[row].index + 1u, corner.face - rows[row].first_face, row, IS_TRIANGLE);
}
