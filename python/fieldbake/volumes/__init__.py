"""Signed distance fields on dense, quantised and sparse grids."""
