"""The same option has the same name, order and default in every function."""

from __future__ import annotations

import inspect

import pytest
import typer

import fieldbake as fb
from fieldbake.cli.application import app, load

TRIANGLE = ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])

#: Options whose default depends on the kind of result.
OWN_DEFAULTS = {"resolution", "band"}


def options_of(function):
    """The defaults of the options of a function, in its order."""
    parameters = inspect.signature(function).parameters.values()
    return {one.name: one.default for one in parameters if one.default is not inspect.Parameter.empty}


def assert_same_options(reference, other, leave_out=()):
    """The options of `reference` that `other` has are in the same order, with the same defaults."""
    expected, found = options_of(reference), options_of(other)
    shared = [name for name in expected if name in found]
    assert [name for name in found if name in expected] == shared
    for name in set(shared) - set(leave_out):
        assert found[name] == expected[name], name
    return shared


@pytest.mark.parametrize("function", [fb.bake_sparse, fb.bake_to_zarr])
def test_bakes_take_the_options_of_bake_in_its_order(function):
    shared = assert_same_options(fb.bake, function, OWN_DEFAULTS)
    assert shared == list(options_of(fb.bake))


def test_many_bakes_take_all_options_of_bake(tmp_path):
    given = {**options_of(fb.bake), "resolution": 8}
    rows = fb.bake_many({"ball": fb.sphere()}, tmp_path, workers=1, **given)
    assert rows[0]["status"] == "done"


@pytest.mark.parametrize(
    "call", [lambda _, **o: fb.bake_sparse(TRIANGLE, **o), lambda place, **o: fb.bake_to_zarr(TRIANGLE, place, **o)]
)
def test_bakes_on_the_cpu_alone_refuse_other_devices(call, tmp_path):
    with pytest.raises(fb.ArgumentError, match=r"^device: bake_\w+ runs on the CPU only; leave it out or pass \"cpu\""):
        call(tmp_path / "a.zarr", device="gpu")
    with pytest.raises(fb.ArgumentError, match=r"^device: must be text, got 3"):
        call(tmp_path / "a.zarr", device=3)


def test_a_store_has_no_sheets(tmp_path):
    for options in ({"two_sided": True}, {"thickness": 0.1}):
        with pytest.raises(fb.ArgumentError, match="bake_to_zarr bakes no sheets; use bake or bake_sparse"):
            fb.bake_to_zarr(TRIANGLE, tmp_path / "a.zarr", **options)


def test_pictures_have_the_same_options():
    assert assert_same_options(fb.render, fb.Renderer) == list(options_of(fb.Renderer))
    shared = assert_same_options(fb.render, fb.raymarch)
    assert {"size", "shadows", "device", "progress"} <= set(shared)
    assert options_of(fb.raymarch)["shadows"] == "soft"


def test_the_command_has_the_options_of_render():
    load("render")
    parameters = typer.main.get_command(app).get_command(None, "render").params
    found = {one.name: one.default for one in parameters if one.name in options_of(fb.render)}
    expected = options_of(fb.render)
    # Cameras have options of their own; fields and callables have no text on a command line.
    for name in ("camera", "far", "far_distance", "progress"):
        del expected[name]
    expected["size"] = "{}x{}".format(*expected["size"])
    assert list(found.items()) == list(expected.items())
