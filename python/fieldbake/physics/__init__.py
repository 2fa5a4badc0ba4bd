"""Fields for physics engines."""
