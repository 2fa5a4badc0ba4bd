"""The camera: its position, its viewing direction, and its field of view or the height of its picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ArgumentError, SceneError

#: Largest cosine between `up` and the viewing direction; above it the roll of the camera is undefined.
PARALLEL = 1.0 - 1e-9

#: Largest deviation of a rotation from orthonormal; poses stored in float32 are accepted.
RIGID_TOLERANCE = 1e-4


class Camera:
    """A pinhole camera in the pose of OpenGL: it looks along its -Z axis, and +Y points upwards.

    :meth:`orthographic` makes a camera with parallel rays.

    Parameters
    ----------
    eye : (3,)
        Position, world units.
    target : (3,)
        A point on the optical axis, world units.
    up : (3,), default (0, 1, 0)
        Direction that points upwards in the picture. It need not be perpendicular to the viewing direction.
    fov_deg : float, default 45
        Vertical field of view in degrees, above 0 and below 180.

    Raises
    ------
    SceneError
        If a value is not finite, `eye` equals `target`, `up` is parallel to the view, or `fov_deg` is out of range.

    Examples
    --------
    >>> camera = Camera((0, 0, 3), (0, 0, 0))
    >>> camera.pose[:3, 3].tolist()
    [0.0, 0.0, 3.0]
    """

    __slots__ = ("_fov_deg", "_height", "_pose", "_target")

    def __init__(
        self, eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0), fov_deg: float = 45.0
    ) -> None:
        pose, ahead = _pose(eye, target, up)
        self._set(pose, ahead, fov_deg, None)

    def _set(
        self, pose: NDArray[np.float64], target: NDArray[np.float64], fov_deg: float, height: float | None
    ) -> None:
        """Set the properties. With a height the rays are parallel, and the field of view is 0."""
        try:
            self._height = None if height is None else checks.number("height", height, above=0)
            self._fov_deg = 0.0 if height is not None else checks.number("fov_deg", fov_deg, above=0)
        except ArgumentError as error:
            raise SceneError(str(error)) from None
        if self._fov_deg >= 180:
            raise SceneError(f"fov_deg: must be below 180, got {self._fov_deg:g}")
        self._pose = checks.frozen(pose)
        self._target = checks.frozen(target)

    @classmethod
    def orthographic(
        cls, eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0), *, height: float
    ) -> Camera:
        """Make a camera with parallel rays, so that objects have the same size at any depth.

        Rays start on the plane through `eye` across the viewing direction; surfaces behind it are invisible. Pages and
        live views have perspective cameras only.

        Parameters
        ----------
        eye : (3,)
            Centre of the picture on the plane where the rays start, world units.
        target : (3,)
            A point on the optical axis, world units.
        up : (3,), default (0, 1, 0)
            Direction that points upwards in the picture. It need not be perpendicular to the viewing direction.
        height : float
            Height of the picture, world units. Its width follows from the size of the picture in pixels.

        Raises
        ------
        SceneError
            If a value is not finite, `eye` equals `target`, `up` is parallel to the view, or `height` is not above 0.

        Examples
        --------
        >>> camera = Camera.orthographic((0, 0, 3), (0, 0, 0), height=2.5)
        >>> camera.height, camera.fov_deg
        (2.5, 0.0)
        """
        camera = cls.__new__(cls)
        pose, ahead = _pose(eye, target, up)
        if height is None:
            raise SceneError("height: must be a finite number above 0, got None")
        camera._set(pose, ahead, 0.0, height)
        return camera

    @classmethod
    def from_pose(cls, pose: ArrayLike, fov_deg: float = 45.0, *, height: float | None = None) -> Camera:
        """Make a camera from the pose of another program, such as pyrender, or of a glTF file.

        Parameters
        ----------
        pose : (4, 4)
            World from camera: a rotation and a translation, column vectors.
        fov_deg : float, default 45
            Vertical field of view in degrees.
        height : float, optional
            Height of the picture of an orthographic camera, world units; `fov_deg` does not apply then.

        Raises
        ------
        SceneError
            If the pose is not a rotation with a translation.
        """
        matrix = checks.affine("pose", pose, SceneError)
        rotation = matrix[:3, :3]
        if not np.allclose(rotation.T @ rotation, np.eye(3), atol=RIGID_TOLERANCE) or np.linalg.det(rotation) < 0:
            raise SceneError(f"pose: the 3x3 part must be a rotation, got {rotation.tolist()}")
        camera = cls.__new__(cls)
        camera._set(matrix, matrix[:3, 3] - matrix[:3, 2], fov_deg, height)
        return camera

    @classmethod
    def fit(
        cls,
        bounds: ArrayLike,
        *,
        direction: ArrayLike = (-0.55, -0.4, -1.0),
        up: ArrayLike = (0.0, 1.0, 0.0),
        fov_deg: float = 45.0,
        aspect: float = 1.0,
        border: float = 0.05,
        orthographic: bool = False,
    ) -> Camera:
        """Make a camera that shows a box in the middle of the picture, as large as it fits.

        Parameters
        ----------
        bounds : (2, 3)
            Lower and upper corner, world units.
        direction : (3,), default (-0.55, -0.4, -1)
            Viewing direction. The default views the box from the front, the right and slightly above.
        up : (3,), default (0, 1, 0)
            Direction that points upwards in the picture.
        fov_deg : float, default 45
            Vertical field of view in degrees.
        aspect : float, default 1
            Width of the picture over its height.
        border : float, default 0.05
            Fraction of the picture left free around the box.
        orthographic : bool, default False
            Whether the rays are parallel; `fov_deg` does not apply then.

        Raises
        ------
        SceneError
            If the box is a single point or a value is out of range.
        """
        box = checks.box("bounds", bounds, SceneError, flat=True)
        center = (box[0] + box[1]) / 2
        forward = checks.vector("direction", direction, 3, SceneError)
        try:
            aspect = checks.number("aspect", aspect, above=0)
            border = checks.number("border", border, least=0)
            orthographic = checks.flag("orthographic", orthographic)
        except ArgumentError as error:
            raise SceneError(str(error)) from None
        radius = float(np.linalg.norm(box[1] - box[0])) / 2
        if not radius > 0:
            raise SceneError(
                f"bounds: the box is the point {box[0].tolist()}; a shape with such a box is empty, because its parts "
                "do not overlap"
            )
        if not np.linalg.norm(forward) > 0:
            raise SceneError("direction: must have a length, got (0, 0, 0)")
        forward /= np.linalg.norm(forward)
        # This camera supplies the axes and the checks; its distance is computed below.
        aim = cls(center - forward * radius, center, up, fov_deg)
        if orthographic:
            # The box is symmetric about its centre, so two sums are its half extents in the picture. A line along the
            # view has none. The eye lies outside the sphere around the box.
            half = np.abs(aim.pose[:3, :2]).T @ (box[1] - center)
            height = 2 * (1 + border) * max(float(half[0]) / aspect, float(half[1]), 1e-6 * radius)
            return cls.orthographic(center - 1.01 * radius * forward, center, up, height=height)

        # A corner at (x, y, depth) from the centre is visible from (ex, ey, distance) if |x - ex| <= aspect * slope *
        # (distance - depth) and |y - ey| <= slope * (distance - depth). On each axis two corners attain the limits.
        slope = np.tan(np.radians(aim.fov_deg) / 2) / (1 + border)
        corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]]) - center
        x, y, depth = (corners @ aim.pose[:3, axis] for axis in range(3))
        wide, tall = slope * aspect, slope
        right, left = (x + wide * depth).max(), (wide * depth - x).max()
        above, below = (y + tall * depth).max(), (tall * depth - y).max()
        center = center + aim.pose[:3, :2] @ np.array([right - left, above - below]) / 2
        needed = max((right + left) / (2 * wide), (above + below) / (2 * tall))
        # The camera stays outside the sphere around the box, so that a wide field of view does not start inside it.
        distance = max(float(needed), 1.01 * radius)
        return cls(center - forward * distance, center, up, fov_deg)

    @property
    def pose(self) -> NDArray[np.float64]:
        """World from camera, (4, 4), read-only."""
        return self._pose

    @property
    def eye(self) -> NDArray[np.float64]:
        """Position, (3,), world units."""
        return self._pose[:3, 3]

    @property
    def target(self) -> NDArray[np.float64]:
        """A point on the optical axis, (3,), world units."""
        return self._target

    @property
    def up(self) -> NDArray[np.float64]:
        """Upward direction of the picture, (3,), unit length."""
        return self._pose[:3, 1]

    @property
    def fov_deg(self) -> float:
        """Vertical field of view, degrees; 0 for an orthographic camera."""
        return self._fov_deg

    @property
    def height(self) -> float | None:
        """Height of the picture of an orthographic camera, world units; None for a perspective camera."""
        return self._height

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, name):
            raise AttributeError(f"a Camera cannot be changed ({name}); make a new one")
        super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (np.array(self._pose), np.array(self._target), self._fov_deg, self._height)

    def __repr__(self) -> str:
        eye, target = (", ".join(f"{x:.4g}" for x in p) for p in (self.eye, self._target))
        if self._height is not None:
            return f"Camera.orthographic(eye=({eye}), target=({target}), height={self._height:g})"
        return f"Camera(eye=({eye}), target=({target}), fov_deg={self._fov_deg:g})"


def _pose(eye: ArrayLike, target: ArrayLike, up: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Check the position, the target and the upward direction; return the pose, (4, 4), and the target, (3,)."""
    position = checks.vector("eye", eye, 3, SceneError)
    ahead = checks.vector("target", target, 3, SceneError)
    upward = checks.vector("up", up, 3, SceneError)
    for name, place in (("eye", position), ("target", ahead), ("up", upward)):
        if np.abs(place).max() > checks.FAR:
            raise SceneError(f"{name}: must be at most {checks.FAR:g} from 0, got {place.tolist()}")
    if not np.linalg.norm(position - ahead) > 0:
        raise SceneError(f"target: must differ from eye, both are {position.tolist()}")
    if not np.linalg.norm(upward) > 0:
        raise SceneError("up: must have a length, got (0, 0, 0)")
    backward = (position - ahead) / np.linalg.norm(position - ahead)
    upward /= np.linalg.norm(upward)
    if abs(backward @ upward) > PARALLEL:
        raise SceneError(f"up: must not be parallel to the view, got {upward.tolist()}; try (0, 0, 1)")
    right = np.cross(upward, backward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0] = right
    pose[:3, 1] = np.cross(backward, right)
    pose[:3, 2] = backward
    pose[:3, 3] = position
    return pose, ahead


def _restore(
    pose: NDArray[np.float64], target: NDArray[np.float64], fov_deg: float, height: float | None = None
) -> Camera:
    camera = Camera.__new__(Camera)
    camera._set(pose, target, fov_deg, height)
    return camera
