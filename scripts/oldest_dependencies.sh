#!/usr/bin/env bash
# Install fieldbake with the oldest versions that pyproject.toml allows, and use it: oldest_dependencies.sh WHEEL|FOLDER
# Needs uv. PYTHON names the interpreter; the environment lies in a temporary folder.
set -euo pipefail
package=$(realpath "$1")
project=$(realpath "$(dirname "$0")/../pyproject.toml")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

uv venv --quiet --python "${PYTHON:-3.10}" "$folder/venv"
export VIRTUAL_ENV=$folder/venv
# "Direct" are the requirements of the project, if its own file names them; their own requirements are the newest.
uv pip install --quiet --resolution lowest-direct -r "$project" --extra notebook --extra plot --extra xarray --extra zarr
uv pip install --quiet --no-deps "$package"
cd "$folder"
venv/bin/fieldbake demo --resolution 32 --output out
venv/bin/fieldbake --help
venv/bin/fieldbake doctor
venv/bin/python - <<'PYTHON'
import sys

import fieldbake as fb

volume = fb.bake(fb.models.torus_knot(), 32)
for name in ("a.npz", "a.vdb", "a.ktx2", "a.nrrd", "a.vti"):
    volume.save(name)
    fb.load(name)
volume.to_mesh().save("a.glb")
fb.load_mesh("a.glb")
fb.render(fb.load_scene("a.glb"), size=(32, 32)).save("a.png")
fb.pack([volume], page_size="fit").save("atlas.png")
fb.query(fb.models.gear(), [(0, 0, 0)])
volume.to_xarray()
volume.plot_slices()
if sys.version_info >= (3, 11):  # Zarr needs it
    fb.bake_to_zarr(fb.models.gear(), "a.zarr", 64)
print("the oldest dependencies work")
PYTHON
