"""Constructive solid geometry and quadrics."""
