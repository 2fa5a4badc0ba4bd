"""The command line."""

from . import libraries, queries  # registers its commands
from .commands import main

__all__ = ["libraries", "main", "queries"]
