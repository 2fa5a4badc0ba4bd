"""One distance field for all instances of a scene."""
