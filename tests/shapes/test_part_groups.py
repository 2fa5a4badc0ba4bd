"""Parts of a decomposition, grouped by structure for instanced drawing."""

import copy
import pickle

import numpy as np
import pytest

import fieldbake as fb


def model():
    row = [fb.sphere(0.5).translate((2 * i, 0, 0)) for i in range(5)]
    row += [fb.box((1, 2, 1)).rotate("z", 10 * i).translate((3 * i, 4, 0)) for i in range(3)]
    return fb.Shape.union(*row) - fb.cylinder(0.2, 20).rotate("y", 90)


@pytest.mark.parametrize("method", ["aabb", "octree"])
def test_every_box_is_an_instance_with_the_parameters_of_its_part(method):
    parts = fb.csg.decompose(model(), method=method)

    groups = parts.groups("glsl")

    assert len(groups) == parts.structures >= 2
    assert sum(len(group.boxes) for group in groups) == sum(len(part.boxes) for part in parts)
    for group in groups:
        assert len(group.boxes) == len(group.numbers) == len(group.parts)
        for box, numbers, index in zip(group.boxes, group.numbers, group.parts, strict=True):
            part = parts[index]
            assert (part.boxes == box).all(axis=(1, 2)).any()
            assert np.array_equal(numbers, part.shader_numbers())
            assert group.text == part.shape.shader("glsl")


def test_groups_are_drawn_from_near_to_far():
    parts = fb.csg.decompose(model(), method="octree")
    eye = np.array((-5.0, 1.0, 9.0))

    groups = parts.groups(eye=eye)

    starts = []
    for group in groups:
        # A ray to the nearest point of a box has the length of the distance to the box.
        outside = np.maximum(np.maximum(group.boxes[:, 0] - eye, eye - group.boxes[:, 1]), 0)
        distances = np.sqrt((outside**2).sum(axis=1))
        assert (np.diff(distances) >= -1e-12).all()
        starts.append(distances[0])
    assert (np.diff(starts) >= -1e-12).all()
    same = {
        (int(i), box.tobytes()) for group in parts.groups() for i, box in zip(group.parts, group.boxes, strict=True)
    }
    assert same == {
        (int(i), box.tobytes()) for group in groups for i, box in zip(group.parts, group.boxes, strict=True)
    }


def test_mistakes_name_the_argument():
    parts = fb.csg.decompose(fb.sphere())
    with pytest.raises(fb.ShapeError, match="eye"):
        parts.groups(eye=(0, 0, np.nan))
    with pytest.raises(fb.ShapeError, match="language"):
        parts.groups("spirv")
    assert fb.csg.decompose(fb.sphere() & fb.sphere().translate((9, 0, 0))).groups(eye=(0, 0, 0)) == []


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda parts: pickle.loads(pickle.dumps(parts))])
def test_parts_pickle_and_copy(copied, random):
    points = random.uniform(-3, 3, (50, 3))
    parts = fb.csg.decompose(model(), method="aabb")
    structures = parts.structures

    found = copied(parts)

    assert type(found) is type(parts)
    assert found.structures == structures
    assert len(found) == len(parts)
    for one, other in zip(found, parts, strict=True):
        assert np.array_equal(one.boxes, other.boxes)
        assert np.array_equal(one.shape.distance(points), other.shape.distance(points))
