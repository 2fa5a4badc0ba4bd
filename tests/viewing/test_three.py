"""The example for three.js in Chromium: the field of a .ktx2 file among meshes, against pictures of raymarch."""

from __future__ import annotations

import base64
import subprocess
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
from browser import WEB, node_tool, visit

SIZE = (160, 120)

#: Draws the field, and a red plane at z = 0 in a second picture.
PROGRAM = """
import * as THREE from "three";
import { fieldMesh } from "EXAMPLE";
window.draw = async (text, width, height, pose, fov) => {
  const file = Uint8Array.from(atob(text), (character) => character.charCodeAt(0)).buffer;
  const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
  renderer.setSize(width, height, false);
  const camera = new THREE.PerspectiveCamera(fov, width / height, 0.1, 50);
  camera.matrixAutoUpdate = false;
  camera.matrix.set(...pose);
  camera.updateMatrixWorld(true);
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0, 0, 1);
  scene.add(await fieldMesh(file, renderer, 0x00ff00));
  const gl = renderer.getContext();
  const picture = () => {
    renderer.render(scene, camera);
    const bytes = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  };
  const alone = picture();
  const plane = new THREE.Mesh(new THREE.PlaneGeometry(40, 40), new THREE.MeshBasicMaterial({ color: 0xff0000 }));
  scene.add(plane);
  return [alone, picture()];
};
"""


@pytest.mark.slow
def test_a_field_and_meshes_hide_each_other(tmp_path: Path) -> None:
    node_tool("three")
    volume = fb.bake(fb.models.torus_knot(), 48, device="cpu")
    file = tmp_path / "field.ktx2"
    volume.save(file, encoding="unorm8")
    camera = fb.Camera((1.5, 2.0, 6.5), (0, 0, 0), fov_deg=40)
    frame = fb.raymarch(volume, camera, size=SIZE, device="cpu")

    example = WEB.parent / "examples" / "web" / "field_material.js"
    program = tmp_path / "program.js"
    program.write_text(PROGRAM.replace("EXAMPLE", example.as_posix()), encoding="utf-8")
    command = [node_tool(".bin/esbuild"), str(program), "--bundle", "--format=esm"]
    command += [
        f"--alias:three={WEB}/node_modules/three",
        f"--alias:three/addons={WEB}/node_modules/three/examples/jsm",
    ]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    page = tmp_path / "page.html"
    page.write_text(f"<!doctype html><meta charset=utf-8><script type=module>{built.stdout}</script>", encoding="utf-8")
    data = base64.b64encode(file.read_bytes()).decode()
    pose = camera.pose.ravel().tolist()
    expression = f'draw("{data}", {SIZE[0]}, {SIZE[1]}, {pose}, {camera.fov_deg})'
    script = f"await page.waitForLoadState(); return page.evaluate({expression!r});"
    (result,) = visit([{"url": page.as_uri(), "script": script}])
    assert result.value is not None, result.errors
    assert [error for error in result.errors if "GPU stall" not in error] == []
    alone, both = (
        np.frombuffer(base64.b64decode(text), np.uint8).reshape(SIZE[1], SIZE[0], 4)[::-1] for text in result.value
    )
    hit = np.isfinite(frame.depth)
    assert hit.mean() > 0.05
    # The tracer stops 1e-4 diagonals before the surface, which only pixels of the silhouette show.
    assert ((alone[..., 1] > 20) == hit).mean() >= 0.99
    # The plane z = 0 is at this depth along the viewing axis.
    height, width = frame.depth.shape
    pixel = 2 * np.tan(np.radians(camera.fov_deg) / 2) / height
    x = (np.arange(width) + 0.5 - width / 2) * pixel
    y = (height / 2 - np.arange(height) - 0.5) * pixel
    right, up, back, eye = camera.pose[:3].T
    along_z = x * right[2] + y[:, None] * up[2] - back[2]
    plane = np.where(along_z < 0, -eye[2] / along_z, np.inf)
    shows_field = hit & (frame.depth < plane)
    assert shows_field.sum() > 100
    assert (hit & ~shows_field).sum() > 100
    assert ((both[..., 1] > 20) == shows_field).mean() >= 0.99
    assert ((both[..., 0] == 255) == ~shows_field).mean() >= 0.99
