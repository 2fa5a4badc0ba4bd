"""Meshes extracted from distance fields: isosurfaces, solids, offsets and Booleans."""
