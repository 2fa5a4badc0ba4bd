"""Warnings that a user sees once per call, at the line that made the call."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence

from .errors import SurfaceWarning

PACKAGE = __name__.partition(".")[0]


def warn_surface(messages: Sequence[str]) -> None:
    """Raise one `SurfaceWarning` with all messages about the surface; nothing without any.

    Messages about the device start with its argument's name and are a `PerformanceWarning` of their own.
    """
    of_surface = [message for message in messages if not message.startswith("device=")]
    if of_surface:
        warnings.warn("; ".join(of_surface), SurfaceWarning, stacklevel=_depth_of_caller())


def _depth_of_caller() -> int:
    """How many frames up the first one outside this package is, as `warnings.warn` counts from `warn_surface`."""
    depth = 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == PACKAGE:
        frame = frame.f_back
        depth += 1
    return depth
