"""Merging with a graphics device: the field equals the field of the CPU, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
import meshes
from fieldbake import _core
from merged import placed, random_scene, turn


@pytest.fixture
def facts(monkeypatch):
    """Collect the report of the core for each merge."""
    said = []
    core_merge = _core.merge

    def merge(*arguments, **options):
        result = core_merge(*arguments, **options)
        said.append(result[2])
        return result

    monkeypatch.setattr(_core, "merge", merge)
    return said


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_field_of_the_cpu_bit_for_bit(seed, gpu, facts):
    random = np.random.default_rng(seed)
    instances, _ = random_scene(random, 12, rigid=bool(seed % 2), spread=2.0 + seed)
    cpu = fb.merge(instances, 32, device="cpu")
    device = fb.merge(instances, 32, device=gpu)
    assert np.array_equal(cpu.distances, device.distances)
    assert device.report.device != "cpu"
    # The device decides nearly all of them.
    assert facts[-1]["undecided"] < 0.15 * cpu.distances.size
    moved = [(3, placed(turn(random), (0.5, 0.5, 0.5)))]
    assert np.array_equal(cpu.update(moved).distances, device.update(moved).distances)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_far_from_the_origin_and_at_any_scale(scale, offset, gpu, facts):
    random = np.random.default_rng(11)
    instances, _ = random_scene(random, 8)
    to = np.diag([scale, scale, scale, 1.0])
    to[:3, 3] = offset * scale
    instances = [(geometry, to @ transform) for geometry, transform in instances]
    cpu, device = (fb.merge(instances, 24, device=place) for place in ("cpu", gpu))
    assert np.array_equal(cpu.distances, device.distances)
    assert facts[-1]["undecided"] < 0.15 * cpu.distances.size


def test_what_the_device_does_not_know_is_asked_on_the_cpu(gpu, random):
    ball = meshes.icosphere(2)
    cut = fb.bake(ball, 24, bounds=[(-1.2, -1.2, -1.2), (0.1, 1.2, 1.2)])
    whole = fb.bake(ball, 24)
    geometries = [
        cut,
        (whole, placed(turn(random), (3, 0, 0))),
        (fb.Quadric.paraboloid(), placed(turn(random), (0, 3, 0))),
        # On its own lattice every sample lies on faces of cells.
        (whole, placed(np.eye(3), (8 * whole.spacing[0] * 8, 0, 0))),
    ]
    cpu, device = (fb.merge(geometries, 40, device=place) for place in ("cpu", gpu))
    assert np.array_equal(cpu.distances, device.distances)
    alone = [fb.merge([whole], whole.resolution, bounds=whole.bounds, device=place) for place in ("cpu", gpu)]
    assert np.array_equal(alone[0].distances, alone[1].distances)


def test_nested_levels_too(gpu):
    instances, _ = random_scene(np.random.default_rng(2), 6)
    cpu, device = (fb.merge(instances, 16, levels=3, device=place) for place in ("cpu", gpu))
    for a, b in zip(cpu.levels, device.levels, strict=True):
        assert np.array_equal(a.distances, b.distances)
