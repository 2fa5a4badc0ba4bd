"""Closed meshes with faces of almost no area: every count uses one closed surface."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fieldbake as fb
import meshes

CUBE = meshes.box()
#: Widths of slivers, relative to edges near 1: from a face on a line to one of ordinary shape.
WIDTHS = [0.0, 1e-17, 1e-16, 1e-15, 1e-13, 1e-10, 1e-9, 1e-7, 1e-4, 1e-2]
#: Distance from the surface, relative to the diagonal, from which a side must be right.
CLEAR = 1e-8


def with_slivers(random, sides, count):
    """Split faces of a box `count` times at a point beside an edge: vertices and faces of the same solid."""
    vertices = [tuple(corner * sides) for corner in CUBE.vertices]
    faces = [list(face) for face in CUBE.faces]
    for _ in range(count):
        face = random.integers(len(faces))
        turn = random.integers(3)
        a, b, c = np.roll(faces[face], turn)
        from_, to, apex = (np.array(vertices[v]) for v in (a, b, c))
        point = from_ + (to - from_) * random.uniform(0.1, 0.9)
        point = point + (apex - point) * random.choice(WIDTHS)
        # The point stays in the plane of its side.
        on_side = (from_ == to) & (to == apex)
        point[on_side] = from_[on_side]
        added = len(vertices)
        vertices.append(tuple(point))
        faces[face] = [a, b, added]
        faces += [[b, c, added], [c, a, added]]
    return np.array(vertices), np.array(faces)


class Solid:
    """A box with slivers, turned and moved, as a mesh and in closed form."""

    def __init__(self, random, turned, split, far):
        self.half = np.exp(random.uniform(-1, 1, 3))
        vertices, faces = with_slivers(random, self.half, random.integers(1, 25))
        self.turn = Rotation.random(random_state=int(random.integers(1 << 30))).as_matrix() if turned else np.eye(3)
        self.place = random.normal(size=3) * far
        self.vertices = vertices @ self.turn.T + self.place
        if split:
            self.vertices, faces = self.vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
        self.mesh = fb.Mesh(self.vertices, faces)
        self.diagonal = 2 * np.linalg.norm(self.half)
        # A position is rounded by half a unit in the last place of its largest coordinate, for each of three products.
        self.rounding = 2e-15 * np.abs(self.vertices).max()

    def distance(self, points):
        """Signed distances of points, closed form."""
        beside = np.abs((points - self.place) @ self.turn) - self.half
        return np.linalg.norm(np.maximum(beside, 0), axis=1) + np.minimum(beside.max(axis=1), 0)

    def points(self, random):
        """Points around the solid, and on lines along the axes through its vertices, that are clear of the surface."""
        around = self.place + (random.uniform(-1.3, 1.3, (40, 3)) * self.half) @ self.turn.T
        aligned = self.vertices[random.integers(len(self.vertices), size=60)]
        aligned[np.arange(60), random.integers(3, size=60)] += random.uniform(-2, 2, 60) * self.half.max()
        points = np.concatenate([around, aligned])
        return points[np.abs(self.distance(points)) > CLEAR * self.diagonal + self.rounding]

    def crossings(self, origins, directions):
        """Hits of rays, closed form, and which rays are clear of edges and of the surface at their origin."""
        start, along = (origins - self.place) @ self.turn, directions @ self.turn
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(-self.half - start) / along, (self.half - start) / along])
        parallel = np.abs(along) < 1e-12 * np.abs(along).max(axis=1, keepdims=True)
        within = np.abs(start) < self.half
        enter = np.where(parallel, np.where(within, -np.inf, np.inf), ends.min(axis=0)).max(axis=1)
        leave = np.where(parallel, np.where(within, np.inf, -np.inf), ends.max(axis=0)).min(axis=1)
        length = np.linalg.norm(along, axis=1)
        margin = 1e-6 * self.diagonal
        clear = np.abs(leave - enter) * length > margin
        clear &= ~(parallel & (np.abs(np.abs(start) - self.half) < margin)).any(axis=1)
        clear &= (np.abs(enter) * length > margin) & (np.abs(leave) * length > margin)
        count = np.where(enter > leave, 0, (leave > 0).astype(int) + (enter > 0))
        return count, clear


@pytest.mark.parametrize("far", [0, 1e3, 1e6])
@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_boxes_with_slivers_have_the_sides_and_hits_of_boxes(random, turned, split, far):
    for _ in range(12):
        solid = Solid(random, turned, split, far)
        points = solid.points(random)
        inside = solid.distance(points) < 0

        assert solid.mesh.is_closed
        assert np.array_equal(fb.contains(solid.mesh, points), inside)
        assert np.array_equal(fb.signed_distance(solid.mesh, points) < 0, inside)
        assert np.abs(np.abs(fb.winding_number(solid.mesh, points)) - inside).max() <= 1e-6

        # Far off, vertices are rounded across edges, so that rays to them and along axes cross real folds.
        directions = random.normal(size=points.shape)
        if far == 0:
            along_axis = random.random(len(points)) < 0.6
            directions[along_axis] = np.eye(3)[random.integers(3, size=along_axis.sum())]
            to_vertices = ~along_axis
            directions[to_vertices] = solid.vertices[random.integers(len(solid.vertices))] - points[to_vertices]
        count, clear = solid.crossings(points, directions)
        hits = fb.cast_rays(solid.mesh, points, directions)
        assert np.array_equal(fb.count_intersections(solid.mesh, points, directions)[clear], count[clear])
        assert np.array_equal(fb.occluded(solid.mesh, points, directions)[clear], count[clear] > 0)
        assert np.array_equal(hits.hit[clear], count[clear] > 0)
        places = points[hits.hit] + hits.t[hits.hit, None] * directions[hits.hit]
        assert np.abs(solid.distance(places)).max() <= 1e-9 * solid.diagonal + solid.rounding


@pytest.mark.parametrize("width", [1e-9, 1e-12])
def test_a_vertex_beside_a_diagonal_leaves_no_crack(width):
    # A face of the side x = -1, and the point beside its longest edge, towards its third corner.
    face = next(face for face in CUBE.faces.tolist() if (CUBE.vertices[face, 0] == -1).all())
    a, b, c = next(
        turned
        for turned in (np.roll(face, turn) for turn in range(3))
        if (np.diff(CUBE.vertices[turned[:2]], axis=0) != 0).sum() == 2
    )
    on_edge = CUBE.vertices[a] + 0.6 * (CUBE.vertices[b] - CUBE.vertices[a])
    across = np.array([0, 0, np.sign(CUBE.vertices[c] - on_edge)[2]])
    vertices = np.concatenate([CUBE.vertices, [on_edge + width * across]])
    others = [other for other in CUBE.faces.tolist() if other != face]
    mesh = fb.Mesh(vertices, [*others, [a, b, 8], [b, c, 8], [c, a, 8]])
    within = [on_edge + [0.7, 0, 0] + 0.2 * width * across]

    assert mesh.is_closed
    assert fb.contains(mesh, within).all()
    assert np.abs(np.abs(fb.winding_number(mesh, within)) - 1).max() <= 1e-6
    origin = [on_edge - [2, 0, 0] + 0.2 * width * across]
    assert np.abs(fb.cast_rays(mesh, origin, [[1, 0, 0]]).t - 2).max() <= 1e-12
    assert fb.count_intersections(mesh, origin, [[1, 0, 0]]) == 2


def test_a_plate_below_float32_has_no_winding_outside(random):
    """Plates of one billionth of their size, whose corners are equal in float32, seen from points above corners."""
    for _ in range(40):
        turn = Rotation.random(random_state=int(random.integers(1 << 30))).as_matrix()
        vertices = (CUBE.vertices * [1, 1, 3e-9]) @ turn.T
        mesh = fb.Mesh(vertices, CUBE.faces)
        for axis in range(3):
            points = vertices.copy()
            points[:, axis] -= random.uniform(1e-3, 1, 8)
            outside = np.abs(fb.signed_distance(mesh, points, sign="unsigned")) > 1e-3

            assert mesh.is_closed
            assert np.abs(fb.winding_number(mesh, points))[outside].max(initial=0) <= 1e-6


def test_rays_in_the_plane_of_a_triangle_hit_it(random):
    for _ in range(60):
        corners = random.normal(size=(3, 3))
        mesh = fb.Mesh(corners, [[0, 1, 2]])
        targets = random.dirichlet((1, 1, 1), 50) @ corners
        directions = random.normal(size=(50, 2)) @ (corners[1:] - corners[0])
        origins = targets - directions * random.uniform(0.5, 3, (50, 1))

        hits = fb.cast_rays(mesh, origins, directions)

        places = (origins + hits.t[:, None] * directions)[hits.hit]
        assert fb.closest_point(mesh, places).distances.max(initial=0) <= 1e-9 * np.ptp(corners, axis=0).max()


def test_the_weights_of_the_closest_point_of_a_sliver_state_that_point(random):
    for width in WIDTHS[1:]:
        turn = Rotation.random(random_state=int(random.integers(1 << 30))).as_matrix()
        corners = np.array([[0, 0, 0], [2, 0, 0], [0.7, width, 0]]) @ turn.T
        mesh = fb.Mesh(np.concatenate([corners, [[5, 5, 5], [6, 5, 5], [5, 6, 5]]]), [[0, 1, 2], [3, 4, 5]])
        points = random.uniform(-1, 3, (200, 3)) @ turn.T

        found = fb.closest_point(mesh, points)

        stated = np.einsum("ij,ijk->ik", found.barycentric, mesh.vertices[mesh.faces[found.faces]])
        assert np.abs(stated - found.points).max() <= 1e-14
        assert np.isfinite(found.normals).all()


def test_an_isolated_wire_below_float32_has_distances():
    """A wire whose faces have no area in float32, beside a cube that sets the scale."""
    wire = CUBE.vertices * [1, 5e-10, 5e-10] + [0, 5, 0]
    mesh = fb.Mesh(np.concatenate([CUBE.vertices, wire]), np.concatenate([CUBE.faces, CUBE.faces + 8]))

    distances = fb.signed_distance(mesh, [[0, 4.5, 0], [0.3, 5, 0.25], [2, 5, 0]])

    assert mesh.is_closed
    assert np.abs(distances - [0.5, 0.25, 1]).max() <= 1e-6 * np.linalg.norm(np.ptp(mesh.vertices, axis=0))


def test_points_just_inside_the_box_of_a_mesh_are_inside(random):
    """The box of the search tree is float32: points between it and the surface are closer than its rounding."""
    for _ in range(40):
        half = np.exp(random.uniform(-1, 1, 3))
        mesh = fb.Mesh(CUBE.vertices * half, CUBE.faces)
        points = random.uniform(-0.9, 0.9, (30, 3)) * half
        sides = random.integers(3, size=30)
        rows = np.arange(30)
        points[rows, sides] = random.choice([-1, 1], 30) * (half[sides] - CLEAR * half.max())

        assert fb.contains(mesh, points).all()
        assert (fb.signed_distance(mesh, points) <= 0).all()


def test_a_face_on_a_line_is_a_segment_unless_it_lies_on_an_edge():
    """The first face extends an edge of the second one, from y = 0.25 to y = 1."""
    vertices = np.array([[0, 0.25, 0], [0, 1, 0], [0, 0, 0], [0.5, 0, 0]])
    mesh = fb.Mesh(vertices, [[0, 1, 2], [3, 0, 2]])
    points = np.array([[-0.25, 0.75, 0], [0, 1.5, 0], [0.25, -0.5, 0]])

    found = fb.closest_point(mesh, points)

    assert np.abs(found.distances - [0.25, 0.5, 0.5]).max() <= 1e-15
    assert np.array_equal(found.faces, [0, 0, 1])
    assert np.isfinite(found.normals).all()
    assert np.abs(np.abs(fb.bake(mesh, 16, sign="unsigned").sample(points)) - found.distances).max() <= 0.05
