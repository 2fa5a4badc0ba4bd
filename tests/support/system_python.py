"""The Python of the system, which may have packages of the system that no wheel provides."""

import subprocess
from pathlib import Path

import pytest

SYSTEM_PYTHON = Path("/usr/bin/python3")


def openvdb_python() -> Path:
    """Return a Python with OpenVDB; skip the test without one."""
    probe = [SYSTEM_PYTHON, "-c", "import numpy\ntry: import pyopenvdb\nexcept ImportError: import openvdb"]
    if not SYSTEM_PYTHON.exists() or subprocess.run(probe, capture_output=True, check=False).returncode:
        pytest.skip("OpenVDB for Python is not installed: apt install python3-openvdb")
    return SYSTEM_PYTHON
