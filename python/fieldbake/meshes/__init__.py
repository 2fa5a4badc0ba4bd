"""Triangle meshes and the conversion of other objects into them."""
