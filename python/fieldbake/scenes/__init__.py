"""Instances, lights, cameras and materials, and the fields kept for them."""
