"""The command line."""

from . import doctor, files, libraries, pictures, queries, solids, view  # they register their commands
from .commands import main

__all__ = ["doctor", "files", "libraries", "main", "pictures", "queries", "solids", "view"]
