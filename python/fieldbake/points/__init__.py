"""Clouds of points: their areas, normals and files."""
