"""Warnings that are issued once per call, at the line of the caller."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence

from .errors import SurfaceWarning

PACKAGE = __name__.partition(".")[0]


def about_surface(messages: Sequence[str]) -> list[str]:
    """List the warnings of a report that are about the surface.

    Messages about the device start with ``device=``; they have become a `PerformanceWarning`.
    """
    return [message for message in messages if not message.startswith("device=")]


def warn_surface(messages: Sequence[str]) -> None:
    """Issue one `SurfaceWarning` with all messages about the surface, if there are any."""
    of_surface = about_surface(messages)
    if of_surface:
        warnings.warn("; ".join(of_surface), SurfaceWarning, stacklevel=_depth_of_caller())


def warn(message: str, category: type[Warning]) -> None:
    """Warn at the line of the caller."""
    warnings.warn(message, category, stacklevel=_depth_of_caller())


def _depth_of_caller() -> int:
    """Count the frames from the caller up to the first one outside this package, as `warnings.warn` counts them."""
    depth = 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == PACKAGE:
        frame = frame.f_back
        depth += 1
    return depth
