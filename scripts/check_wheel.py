"""Check that wheels contain the licences and the SBOM of their crates, and no path of the machine that built them.

python scripts/check_wheel.py dist/*.whl
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from zipfile import ZipFile

ROOT = Path(__file__).parents[1]
LICENSES = ("LICENSE-MIT", "LICENSE-APACHE", "THIRD-PARTY-LICENSES.txt")
SBOM = "fieldbake.cyclonedx.json"

#: Folders of users, and the registry of cargo under any name except the one of scripts/remap_paths.sh.
PATHS = re.compile(rb"[\w.\\/:-]*(?:/home/|/Users/|[A-Z]:\\Users\\|(?<!/cargo[\\/])registry[\\/]src[\\/])[\w.\\/-]*")


def faults(wheel: Path) -> list[str]:
    """Describe what is wrong with a wheel, one line each."""
    with ZipFile(wheel) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    found = []
    for name in (*(f"licenses/{name}" for name in LICENSES), f"sboms/{SBOM}"):
        packed = [content for path, content in files.items() if path.endswith(f".dist-info/{name}")]
        if packed != [(ROOT / Path(name).name).read_bytes()]:
            found.append(f"{name} is not the file of this folder")
    for own in (Path.home(), ROOT):
        # A word after the folder would be another name: roots.py is not below the folder /root.
        named = re.compile(re.escape(str(own).encode()) + rb"(?!\w)")
        found += [f"{path} contains {own}" for path, content in files.items() if named.search(content)]
    for path, content in files.items():
        if path.endswith((".so", ".pyd", ".dylib", ".json")) and (match := PATHS.search(content)):
            found.append(f"{path} contains {match[0].decode()}")
    return found


if __name__ == "__main__":
    lines = [f"{wheel}: {fault}" for wheel in sys.argv[1:] for fault in faults(Path(wheel))]
    print("\n".join(lines))
    sys.exit(bool(lines))
