"""Containers and sidecars on disk, without knowledge of the classes stored in them."""
