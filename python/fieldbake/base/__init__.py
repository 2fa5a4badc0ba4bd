"""Checks, errors, reports and grids that every other package uses."""
