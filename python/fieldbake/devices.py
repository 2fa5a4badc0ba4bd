"""What can compute here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from . import _core


class Device(str):
    """Name of a compute device, fit for any ``device=`` argument, with what is known about it.

    Attributes
    ----------
    backend : str
        ``"cpu"``, ``"vulkan"``, ``"metal"`` or ``"dx12"``.
    type : str
        ``"cpu"``, ``"discrete"``, ``"integrated"``, ``"virtual"``, ``"software"`` or ``"other"``.
    hardware : bool
        False for the CPU and for adapters that run on it.
    limits : mapping
        Largest buffer, texture and the like.
    """

    backend: str
    type: str
    hardware: bool
    limits: Mapping[str, Any]

    @property
    def name(self) -> str:
        """The name as plain text."""
        return str(self)


def devices() -> list[Device]:
    """List the devices; the first is always ``"cpu"``.

    Examples
    --------
    >>> "cpu" in devices()
    True
    """
    found = []
    for facts in _core.devices():
        device = Device(facts["name"])
        device.backend = facts["backend"]
        device.type = facts["type"]
        device.hardware = facts["hardware"]
        device.limits = MappingProxyType(dict(facts["limits"]))
        found.append(device)
    return found
