"""Ambient occlusion: walls that stay closed to wide cones, and the bar of long pictures."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest

import fieldbake as fb
import meshes
from scenes import moved, plane


@pytest.mark.parametrize("thickness", [0.3, 0.05])
def test_a_closed_room_is_dark_from_within(thickness: float, device: str) -> None:
    inner = np.array([2.0, 2.0, 2.0])
    walls = [(-inner - thickness, np.where(np.arange(3) == axis, -inner, inner + thickness)) for axis in range(3)] + [
        (np.where(np.arange(3) == axis, inner, -inner - thickness), inner + thickness) for axis in range(3)
    ]
    room = [fb.Instance(fb.Mesh(*meshes.box(low, high)), resolution=48) for low, high in walls]
    ball = fb.Mesh(*meshes.icosphere(3))
    scene = fb.Scene([*room, fb.Instance(ball, moved(scale=(0.4,) * 3))], lights=[], ambient=1, background=(0, 0, 0))
    camera = fb.Camera((0, 0, 1.8), (0, 0, 0), fov_deg=60)
    frame = fb.render(scene, camera, size=(40, 40), ambient_occlusion=20.0, device=device)
    # Every cone ends at a wall; an edge of the room is one as dark as its cone's rim, 2 % of a disc.
    assert np.all(frame.color[..., :3] <= 0.05)


def test_a_bar_appears_on_a_terminal_in_long_work(monkeypatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    from fieldbake.base import progress

    for delay, draws in ((0.0, True), (60.0, False)):
        screen = Terminal()
        monkeypatch.setattr(sys, "stderr", screen)
        monkeypatch.setattr(progress, "DELAY", delay)
        fb.render(fb.Scene([plane()]), size=(16, 16), device="cpu")
        assert ("render" in screen.getvalue()) == draws
        fb.render(fb.Scene([plane()]), size=(16, 16), device="cpu", progress=False)
        assert draws or not screen.getvalue()
