"""Signed distances, closest points and rays at arbitrary points of a mesh."""
