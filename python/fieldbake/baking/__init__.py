"""Evaluation of meshes and shapes on grids."""
