"""The command line."""

from . import files, libraries, pictures, queries  # registers its commands
from .commands import main

__all__ = ["files", "libraries", "main", "pictures", "queries"]
