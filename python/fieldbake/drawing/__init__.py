"""Frames: scenes and fields drawn into arrays."""
