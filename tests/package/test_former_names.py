"""Names of an earlier version are errors that state the new names."""

from __future__ import annotations

import inspect
import pickle

import pytest
from typer.testing import CliRunner

import fieldbake as fb
from fieldbake.base.former_names import former_names
from fieldbake.cli.application import app

BALL = fb.sphere()

#: Each call has a former name, and the error names it and all of these words.
CALLS = {
    "instance": (lambda: fb.Instance(thing=BALL), "thing", ["Instance", "geometry"]),
    "attribute": (lambda: fb.Instance(BALL).thing, "thing", ["Instance", "geometry"]),
    "raymarch": (lambda: fb.raymarch(thing=BALL), "thing", ["raymarch", "geometry"]),
    "as_mesh": (lambda: fb.as_mesh(thing=BALL), "thing", ["as_mesh", "geometry"]),
    "render": (lambda: fb.render([BALL], method="article"), "method", ["render", "articles/mesh_distance_field"]),
    "renderer": (
        lambda: fb.Renderer([BALL], method="article"),
        "method",
        ["Renderer()", "articles/mesh_distance_field"],
    ),
    "merge": (lambda: fb.merge([BALL], method="article"), "method", ["merge", "articles/fields_in_unity"]),
    "circle": (lambda: fb.sphere_intersection(0, 1, 2, 3), "sphere_intersection", ["articles/fields_in_unity"]),
    "rotate": (lambda: BALL.rotate("x", degrees=9), "degrees", ["rotate", "angle_deg"]),
    "profile": (lambda: fb.circle(1).rotate(degrees=9), "degrees", ["rotate", "angle_deg"]),
    "twist": (lambda: BALL.twist(degrees=9), "degrees", ["twist", "per_unit_deg", "pitch"]),
    "twist by position": (lambda: BALL.twist(9), "Shape.twist", ["per_unit_deg=", "pitch="]),
    "bend": (lambda: BALL.bend(degrees=9), "degrees", ["bend", "per_unit_deg", "radius"]),
    "bend by position": (lambda: BALL.bend(9), "Shape.bend", ["per_unit_deg=", "radius="]),
    "union": (lambda: fb.csg.union(BALL, BALL), "union", ["csg", "|", "Shape.union"]),
    "intersection": (lambda: fb.csg.intersection(BALL), "intersection", ["csg", "&", "Shape.intersection"]),
    "difference": (lambda: fb.csg.difference(BALL), "difference", ["csg", "-", "Shape.difference"]),
    "xor": (lambda: fb.csg.xor(BALL, BALL), "xor", ["csg", "^", "Shape.xor"]),
}


@pytest.mark.parametrize("call", CALLS)
def test_a_former_name_is_an_error_with_the_new_one(call):
    function, name, words = CALLS[call]
    with pytest.raises(fb.ArgumentError) as caught:
        function()
    message = str(caught.value)
    assert message.startswith(f"{name}: ")
    assert [word for word in words if word not in message] == []


def test_the_new_names_work_and_others_are_refused_as_ever():
    instance = fb.Instance(geometry=BALL)
    assert instance.geometry is BALL
    assert not hasattr(instance, "thing")
    with pytest.raises(AttributeError, match="color"):
        _ = instance.color
    with pytest.raises(AttributeError, match="unite"):
        _ = fb.csg.unite
    with pytest.raises(TypeError, match="colour"):
        fb.Instance(BALL, colour=1)
    assert pickle.loads(pickle.dumps(instance)).geometry == BALL


def test_signatures_have_the_new_names_only():
    assert list(inspect.signature(fb.Instance).parameters)[:2] == ["geometry", "transform"]
    assert str(inspect.signature(fb.Shape.twist)).startswith("(self, *, per_unit_deg: ")
    assert list(inspect.signature(fb.Shape.rotate).parameters) == ["self", "axis", "angle_deg"]


def test_a_former_name_beside_the_new_one_is_refused_too():
    @former_names(old="new")
    def function(new=0):
        return new

    assert function(new=3) == function(3) == 3
    with pytest.raises(fb.ArgumentError, match=r"^old: function\(\) .* use new$"):
        function(old=3, new=3)


@pytest.mark.parametrize(
    ("former", "name"),
    [("--fov", "--fov-deg"), ("--angle", "--angle-deg"), ("--occlusion", "--ambient-occlusion")],
)
def test_a_former_option_of_the_command_is_an_error_with_the_new_one(former, name):
    result = CliRunner().invoke(app, ["render", "a.glb", "-o", "a.png", former, "3"], env={"COLUMNS": "200"})
    assert result.exit_code == 2
    assert f"No such option: {former}" in result.output
    assert name in result.output
