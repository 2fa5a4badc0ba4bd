"""Outlines of profiles: curves, paths of SVG, and letters."""
