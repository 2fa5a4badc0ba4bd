"""The compute devices of this machine."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from .. import _core


class Device(str):
    """Name of a compute device with its properties; any ``device=`` argument accepts it.

    Attributes
    ----------
    backend : str
        ``"cpu"``, ``"vulkan"``, ``"metal"`` or ``"dx12"``.
    type : str
        ``"cpu"``, ``"discrete"``, ``"integrated"``, ``"virtual"``, ``"software"`` or ``"other"``.
    hardware : bool
        False for the CPU and for software adapters, which run on the CPU.
    limits : mapping
        Limits of the device, such as the largest buffer in bytes and the largest texture in texels.

    Examples
    --------
    >>> import fieldbake as fb
    >>> cpu = fb.devices()[0]
    >>> cpu.name, cpu.type, cpu.hardware
    ('cpu', 'cpu', False)
    """

    backend: str
    type: str
    hardware: bool
    limits: Mapping[str, Any]

    def __reduce__(self) -> tuple[Any, ...]:
        return _device, (str(self), self.backend, self.type, self.hardware, dict(self.limits))

    @property
    def name(self) -> str:
        """The name as plain text."""
        return str(self)


def devices() -> list[Device]:
    """List the compute devices. The first is always ``"cpu"``.

    Examples
    --------
    >>> "cpu" in devices()
    True
    """
    return [
        _device(facts["name"], facts["backend"], facts["type"], facts["hardware"], facts["limits"])
        for facts in _core.devices()
    ]


def _device(name: str, backend: str, type: str, hardware: bool, limits: Mapping[str, Any]) -> Device:
    device = Device(name)
    device.backend = backend
    device.type = type
    device.hardware = hardware
    device.limits = MappingProxyType(dict(limits))
    return device
