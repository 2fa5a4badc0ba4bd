"""The command line."""

from . import queries  # registers its commands
from .commands import main

__all__ = ["main", "queries"]
