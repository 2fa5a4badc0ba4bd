"""Readers of every file format, by file ending."""
