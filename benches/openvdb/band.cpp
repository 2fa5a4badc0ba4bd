// OpenVDB's narrow band of a mesh behind a C interface, for peers.py.
//
//     g++ -O3 -DNDEBUG -shared -fPIC band.cpp -o libband.so -lopenvdb -ltbb

#include <openvdb/openvdb.h>
#include <openvdb/tools/Dense.h>
#include <openvdb/tools/MeshToVolume.h>

#include <cstddef>
#include <cstdint>
#include <vector>

using openvdb::FloatGrid;

extern "C" {

// A band of `width` voxels on both sides. `vertices` are in grid space, where samples stand at whole numbers; the values
// are multiplied by `spacing`. The grid is the caller's, to be given back to `band_free`.
FloatGrid* band_of_mesh(const float* vertices, std::size_t vertex_count, const std::uint32_t* faces, std::size_t face_count,
                        float width, double spacing) {
    openvdb::initialize();
    std::vector<openvdb::Vec3s> points(vertex_count);
    for (std::size_t i = 0; i < vertex_count; ++i) {
        points[i] = openvdb::Vec3s(vertices + 3 * i);
    }
    std::vector<openvdb::Vec3I> triangles(face_count);
    for (std::size_t i = 0; i < face_count; ++i) {
        triangles[i] = openvdb::Vec3I(faces + 3 * i);
    }
    const openvdb::tools::QuadAndTriangleDataAdapter<openvdb::Vec3s, openvdb::Vec3I> mesh(points, triangles);
    const auto transform = openvdb::math::Transform::createLinearTransform(spacing);
    return new FloatGrid(*openvdb::tools::meshToVolume<FloatGrid>(mesh, *transform, width, width));
}

// The n^3 samples, z fastest; beyond the band the background with its sign.
void band_samples(const FloatGrid* grid, std::uint32_t n, float* out) {
    const int last = static_cast<int>(n) - 1;
    openvdb::tools::Dense<float, openvdb::tools::LayoutZYX> dense({{0, 0, 0}, {last, last, last}}, out);
    openvdb::tools::copyToDense(*grid, dense);
}

void band_free(FloatGrid* grid) { delete grid; }
}
