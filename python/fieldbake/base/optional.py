"""Packages that only some functions need."""

from __future__ import annotations

import importlib
from typing import Any

from .errors import Error


def optional_module(module: str, purpose: str, *, extra: str | None = None) -> Any:
    """Import a module of an optional package.

    Without the package, the error names the `purpose` and the command that installs the `extra` of fieldbake, or the
    package itself.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        install = f"'fieldbake[{extra}]'" if extra else package
        raise Error(f"{purpose} needs the package {package}; install it with: pip install {install}") from error
