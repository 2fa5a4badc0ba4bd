"""Solids as long work: refused resolutions, progress, cancellation, and warnings about the result."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import pytest

import fieldbake as fb

BALL = fb.sphere().to_mesh(24)
CUBE = fb.box(1.5).to_mesh(16)

#: Each function with a parameter for its resolution and its further options.
MADE: dict[str, Callable[..., fb.Mesh]] = {
    "solid": lambda resolution, **options: fb.solid(BALL, resolution, **options),
    "outer": lambda resolution, **options: fb.solid(BALL, resolution, fill="outer", **options),
    "offset": lambda resolution, **options: fb.offset(BALL, 0.1, resolution, **options),
    "shell": lambda resolution, **options: fb.shell(BALL, 0.2, resolution, **options),
    "boolean": lambda resolution, **options: fb.boolean("difference", BALL, CUBE, resolution=resolution, **options),
    "shape": lambda resolution, **options: (fb.sphere() - fb.box(1)).to_mesh(resolution, **options),
}

EXTRACTED: dict[str, Callable[..., fb.Mesh]] = {
    "volume": fb.bake(BALL, 40).to_mesh,
    "sparse": fb.bake_sparse(BALL, 40).to_mesh,
    "without source": fb.Volume(fb.bake(BALL, 40).distances, fb.bake(BALL, 40).bounds).to_mesh,
    "other source": lambda **options: fb.bake(BALL, 40).to_mesh(source=fb.bake(BALL, 20), **options),
}


@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
@pytest.mark.parametrize("resolution", [20_000, 10**9])
def test_resolutions_beyond_a_field_are_refused(made: Callable[..., fb.Mesh], resolution: int) -> None:
    with pytest.raises(
        fb.ArgumentError, match=r"resolution: .* voxels, and a field has at most 1\.1e\+12; use at most"
    ):
        made(resolution)


def of_resolution(made: Callable[..., fb.Mesh]) -> Callable[..., fb.Mesh]:
    return lambda **options: made(40, **options)


JOBS = {**{name: of_resolution(made) for name, made in MADE.items()}, **EXTRACTED}


@pytest.mark.parametrize("job", JOBS.values(), ids=JOBS)
def test_progress_increases_to_the_end(job: Callable[..., fb.Mesh]) -> None:
    seen: list[float] = []
    mesh = job(progress=seen.append)
    assert seen == sorted(seen)
    assert len(seen) > 3
    assert seen[-1] == 1.0
    assert 0 <= seen[0] < 0.9
    assert (mesh.vertices == job(progress=False).vertices).all()


@pytest.mark.parametrize("job", JOBS.values(), ids=JOBS)
def test_an_exception_of_the_callable_stops_the_work(job: Callable[..., fb.Mesh]) -> None:
    class StopError(Exception):
        pass

    calls = 0

    def stop(_: float) -> None:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise StopError

    with pytest.raises(StopError):
        job(progress=stop)
    assert calls == 2
    # Later jobs of this thread have no callable.
    assert fb.contains(BALL, [[0, 0, 0]]).all()
    assert calls == 2


def test_a_callable_may_use_the_package() -> None:
    distances: list[Any] = []
    fb.solid(BALL, 40, progress=lambda _: distances.append(fb.bake(CUBE, 8).distances.min()))
    assert len(distances) > 3
    assert all(distance < 0 for distance in distances)


def test_a_wall_below_a_voxel_is_a_warning() -> None:
    """The voxel is 2 / 38: a wall of half of it may have holes, and faces that cross are divided."""
    ball = fb.sphere().to_mesh(64)
    with pytest.warns(fb.SurfaceWarning) as caught:
        shell = fb.shell(ball, 0.03, 40)
    assert shell.report.self_intersections == 0
    text = str(caught[0].message)
    assert "the wall of 0.03 is thinner than a voxel (0.0526), so it may have holes; raise the resolution" in text
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error", fb.SurfaceWarning)
        assert fb.shell(ball, 0.12, 40).report.self_intersections == 0
