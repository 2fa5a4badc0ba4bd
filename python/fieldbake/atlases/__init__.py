"""Many volumes packed into the pages of one texture array."""
