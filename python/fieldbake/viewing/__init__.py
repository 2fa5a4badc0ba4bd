"""Live views in browsers: pages of one file, and widgets of notebooks."""
