"""Formats of mesh files."""
