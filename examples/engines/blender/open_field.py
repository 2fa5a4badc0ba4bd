"""Make a mesh of a level set with geometry nodes and render it, in Blender 5 or with the package bpy.

blender --background --python open_field.py -- field.vdb picture.png [vertices.npy]
python open_field.py field.vdb picture.png [vertices.npy]
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import mathutils
import numpy as np

THRESHOLD = 0.0  # world units; a positive value grows the mesh, within the band of the file


def mesh_nodes(group: bpy.types.NodeTree, material: bpy.types.Material) -> None:
    """Add the nodes Get Named Grid, Grid to Mesh and Set Material."""
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    names = ("NodeGroupInput", "GeometryNodeGetNamedGrid", "GeometryNodeGridToMesh", "GeometryNodeSetMaterial")
    source, grid, mesh, paint = (group.nodes.new(name) for name in names)
    grid.data_type = "FLOAT"
    grid.inputs["Name"].default_value = "surface"
    mesh.inputs["Threshold"].default_value = THRESHOLD
    paint.inputs["Material"].default_value = material
    group.links.new(source.outputs[0], grid.inputs["Volume"])
    group.links.new(grid.outputs["Grid"], mesh.inputs["Grid"])
    group.links.new(mesh.outputs[0], paint.inputs["Geometry"])
    group.links.new(paint.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])


def main(field: Path, picture: Path, positions: Path | None) -> None:
    """Import the file, add the modifier, write the vertices and a picture."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.object.volume_import(directory=str(field.parent), files=[{"name": field.name}])
    volume = bpy.context.object
    material = bpy.data.materials.new("orange")
    material.diffuse_color = (0.8, 0.25, 0.06, 1)
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.25, 0.06, 1)
    modifier = volume.modifiers.new("mesh", "NODES")
    modifier.node_group = bpy.data.node_groups.new("mesh", "GeometryNodeTree")
    mesh_nodes(modifier.node_group, material)
    geometry = volume.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    vertices = np.empty((len(geometry.mesh.vertices), 3), np.float32)
    geometry.mesh.vertices.foreach_get("co", vertices.reshape(-1))
    if positions is not None:
        np.save(positions, vertices)

    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    center, size = (lower + upper) / 2, float(np.linalg.norm(upper - lower))
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = center + size * np.array((0.6, -1.4, 0.7))
    way = mathutils.Vector(center) - camera.location
    camera.rotation_euler = way.to_track_quat("-Z", "Y").to_euler()
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = 2.0, 0.1
    sun.rotation_euler = (0.7, 0.3, 0.4)
    for created in (camera, sun):
        scene.collection.objects.link(created)
    scene.camera = camera
    bpy.ops.mesh.primitive_plane_add(size=10 * size, location=(center[0], center[1], lower[2]))
    scene.world = bpy.data.worlds.new("world")
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.4, 0.45, 0.5, 1)
    scene.render.engine, scene.cycles.samples = "CYCLES", 24
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = 480, 360
    scene.render.filepath = str(picture)
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    paths = [Path(path).resolve() for path in given]
    main(paths[0], paths[1], paths[2] if len(paths) > 2 else None)
