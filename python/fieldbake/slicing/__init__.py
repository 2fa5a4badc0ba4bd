"""Slices of solids for printers: images and outlines of layers."""
