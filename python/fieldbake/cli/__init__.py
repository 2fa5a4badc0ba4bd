"""The command line."""

from . import files, libraries, pictures, queries, solids, view  # they register their commands
from .commands import main

__all__ = ["files", "libraries", "main", "pictures", "queries", "solids", "view"]
