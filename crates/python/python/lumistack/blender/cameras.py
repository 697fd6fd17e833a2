"""The window in a scene, and Blender's camera for every view through it.

A view has a slope s = (s_x, s_y). At the point (x, y) of the plane z = 0 it shows the content on
the line (x, y, 0) + z (s, 1).

All rays of an oblique view have its slope. Its camera is orthographic, with the sheared matrix
(x, y, z) -> (x + z s_x, y + z s_y, z).

The camera of a perspective view is a pinhole at the eye (D s_x, D s_y, D) that looks straight ahead.
Its picture is shifted to the window by -D s / width, in widths of the picture. D is the distance of
the eye from the window, and `width` is the window's width.

Blender composes a camera's matrix from location, rotation and scale, which cannot express a shear.
So the shear is set as the camera's `matrix_parent_inverse`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

Vector = tuple[float, float, float]
#: A matrix as four rows.
Matrix = tuple[tuple[float, ...], ...]

#: Blender's limit on the shift of a camera.
MOST_SHIFT = 10.0
#: Width of the film of a perspective camera, millimetres. The picture does not depend on this
#: value, since the focal length is scaled with it.
SENSOR_MM = 36.0
#: Distance of the near clipping plane. It is a fraction of the distance from the camera to the
#: window in perspective views, and to the farthest content in oblique views.
NEAREST = 1e-4
#: The window is in the middle of the depths, unless the middle differs by more than this factor
#: from the distance that near surfaces determine.
CENTRED = 1.5
#: Fraction of the picture that the nearest surfaces must cover to have their full weight.
STRAY = 0.02


class WindowError(ValueError):
    """The settings define no valid window or camera; the message names the wrong setting."""


@dataclass(frozen=True)
class Window:
    """The rectangle of zero parallax in the scene."""

    centre: Vector
    #: Unit vectors to the right, up, and to the viewer.
    right: Vector
    up: Vector
    back: Vector
    #: Scene units per millimetre.
    scale: float
    #: Width and height, millimetres.
    size_mm: tuple[float, float]

    def point(self, place_mm: Sequence[float]) -> Vector:
        """Converts a point of display space to the scene."""
        x, y, z = (self.scale * part for part in place_mm)
        return _sum(self.centre, _times(self.right, x), _times(self.up, y), _times(self.back, z))

    def place_mm(self, point: Sequence[float]) -> Vector:
        """Converts a point of the scene to display space."""
        offset = tuple(a - b for a, b in zip(point, self.centre, strict=True))
        x, y, z = (_dot(offset, axis) / self.scale for axis in (self.right, self.up, self.back))
        return (x, y, z)

    def moved_back(self, by_mm: float, distance_mm: float | None = None) -> Window:
        """Moves the window along its normal, so that content at the depth -by_mm comes to the
        display plane. The view from the middle does not change. So for eyes at `distance_mm`, the
        window grows with its distance from the eye."""
        factor = 1.0 if distance_mm is None else (distance_mm + by_mm) / distance_mm
        centre = self.point((0.0, 0.0, -by_mm))
        return Window(centre, self.right, self.up, self.back, self.scale * factor, self.size_mm)

    def resized(self, factor: float, shift: Sequence[float] = (0.0, 0.0)) -> Window:
        """Scales the window by a factor, and moves it in its plane. The shift is to the right and up, in
        widths of the window before it is scaled."""
        width = self.size_mm[0]
        centre = self.point((shift[0] * width, shift[1] * width, 0.0))
        return Window(centre, self.right, self.up, self.back, self.scale * factor, self.size_mm)

    def as_job(self) -> dict[str, object]:
        """Returns the window as the table [window] of a job. It has the coordinates of an exported
        glTF file, in which Blender's point (x, y, z) is (x, z, -y)."""
        forward = _times(self.back, -1.0)
        return {
            "from": "given",
            "centre": y_up(self.centre),
            "forward": y_up(forward),
            "up": y_up(self.up),
            "width": self.scale * self.size_mm[0],
        }


@dataclass(frozen=True)
class ViewCamera:
    """The settings of Blender's camera for one view."""

    #: World matrix, four rows; sheared for oblique views.
    matrix: Matrix
    #: Width of an orthographic picture, scene units; None if perspective.
    ortho_scale: float | None
    #: Focal length in millimetres for a film of SENSOR_MM; None if orthographic.
    lens_mm: float | None
    #: Shift of the picture to the right and up, in widths of the picture.
    shift: tuple[float, float]
    clip_start: float
    clip_end: float


def window_distance(depths: Iterable[float]) -> float | None:
    """Returns the distance of the window for a camera without focus, scene units. None without any
    depth above 0.

    The distance is the middle of the depths; a tenth at either end is ignored, which contains stray
    surfaces and the far end of the ground. But a window in the middle between a subject and a far
    backdrop would show the subject as a speck. So if the middle differs much from the distance
    Σ q / Σ q², q = 1/depth, which near surfaces determine, the window is at that distance, as in
    `crates/shot/src/place/window.rs`.

    depths: distances of the visible surfaces along the camera's axis, scene units.
    """
    ordered = sorted(depth for depth in depths if depth > 0.0)
    if not ordered:
        return None
    tenth = len(ordered) // 10
    middle = (ordered[tenth] + ordered[-1 - tenth]) / 2
    stray = ordered[round(STRAY * (len(ordered) - 1))]
    disparities = [1.0 / max(depth, stray) for depth in ordered]
    near = sum(disparities) / sum(part * part for part in disparities)
    return middle if 1.0 / CENTRED <= middle / near <= CENTRED else near


def window_of_camera(
    matrix: Sequence[Sequence[float]], frame: Sequence[Sequence[float]], orthographic: bool, focus: float, size_mm: tuple[float, float]
) -> Window:
    """Returns the window in a camera's plane of focus. In this plane it is as wide as the camera's
    frustum.

    matrix: world matrix, rows; frame: corners of the picture in camera space, from
    `Camera.view_frame`; focus: distance, scene units.
    """
    if not (math.isfinite(focus) and focus > 0.0):
        raise WindowError(f"camera: expected a focus distance above 0, found {focus}")
    reach = 1.0 if orthographic else -focus / frame[0][2]
    corners = [(reach * corner[0], reach * corner[1]) for corner in frame]
    xs, ys = [corner[0] for corner in corners], [corner[1] for corner in corners]
    width = max(xs) - min(xs)
    if not (math.isfinite(width) and width > 0.0):
        raise WindowError(f"camera: expected a picture of finite width, found {width}")
    columns = [tuple(matrix[row][column] for row in range(3)) for column in range(4)]
    # A camera's scale has no effect in Blender, so the axes are normalized.
    right, up, back = (_unit(column) for column in columns[:3])
    middle = ((max(xs) + min(xs)) / 2, (max(ys) + min(ys)) / 2)
    origin = columns[3]
    centre = _sum((origin[0], origin[1], origin[2]), _times(right, middle[0]), _times(up, middle[1]), _times(back, -focus))
    return Window(centre, right, up, back, width / size_mm[0], size_mm)


def window_of_job(job: dict[str, object], size_mm: tuple[float, float]) -> Window:
    """Converts the table [window] of a job to a window. This is the inverse of `Window.as_job`."""
    centre, forward, up = (z_up(job[key]) for key in ("centre", "forward", "up"))  # type: ignore[arg-type]
    back = _unit(_times(forward, -1.0))
    right = _unit(_cross(up, back))
    return Window(centre, right, _cross(back, right), back, float(job["width"]) / size_mm[0], size_mm)  # type: ignore[arg-type]


def view_camera(window: Window, slope: Sequence[float], distance_mm: float | None, depth_mm: Sequence[float]) -> ViewCamera:
    """Returns the camera of a view.

    slope: of the view, to the right and up; distance_mm: distance of the eye, None for oblique views;
    depth_mm: farthest and nearest depth of content, millimetres along z.
    """
    farthest, nearest = min(depth_mm), max(depth_mm)
    scale, (s_x, s_y) = window.scale, slope
    if distance_mm is None:
        # Place the camera in front of all content; its distance does not affect the picture.
        stand = max(nearest, 0.0) + max(0.05 * (nearest - farthest), 0.01 * window.size_mm[0])
        back = _sum(_times(window.right, s_x), _times(window.up, s_y), window.back)
        origin = window.point((s_x * stand, s_y * stand, stand))
        reach = scale * (stand - farthest) * math.sqrt(1.0 + s_x * s_x + s_y * s_y)
        return ViewCamera(
            _matrix(window.right, window.up, back, origin),
            scale * window.size_mm[0],
            None,
            (0.0, 0.0),
            NEAREST * reach,
            1.05 * reach,
        )
    if not distance_mm > 0.0:
        raise WindowError(f"distance_mm: expected a distance from the eye to the display above 0, found {distance_mm}")
    width = window.size_mm[0]
    shift = (-distance_mm * s_x / width, -distance_mm * s_y / width)
    if max(map(abs, shift)) > MOST_SHIFT:
        found = f"{max(map(abs, shift)):.1f}, since the view is too far to the side of the window, which is {width:.0f} mm wide"
        raise WindowError(f"shift of the camera: expected at most {MOST_SHIFT:.0f} widths of the picture, the most that Blender's cameras support, found {found}")
    lens = SENSOR_MM * distance_mm / width
    if lens < 1.0:
        raise WindowError(f"distance_mm: expected at least {width / SENSOR_MM:.1f} for a window that is {width:.0f} mm wide, found {distance_mm:.1f}")
    reach = scale * max(distance_mm - farthest, 1e-3 * distance_mm)
    matrix = _matrix(window.right, window.up, window.back, window.point((distance_mm * s_x, distance_mm * s_y, distance_mm)))
    return ViewCamera(matrix, None, lens, shift, NEAREST * scale * distance_mm, 1.05 * reach)


def seen_at_mm(camera: ViewCamera, window: Window, point: Sequence[float]) -> tuple[float, float]:
    """Returns the position on the window at which `camera` shows a point of the scene, without
    Blender. Tests use this function."""
    columns = [tuple(camera.matrix[row][column] for row in range(3)) for column in range(4)]
    offset = tuple(a - b for a, b in zip(point, columns[3], strict=True))
    x, y, z = _solve(columns[0], columns[1], columns[2], offset)
    width = window.size_mm[0]
    if camera.ortho_scale is not None:
        return (x / camera.ortho_scale * width, y / camera.ortho_scale * width)
    assert camera.lens_mm is not None
    across, upwards = (camera.lens_mm / SENSOR_MM * part / -z for part in (x, y))
    return ((across - camera.shift[0]) * width, (upwards - camera.shift[1]) * width)


def y_up(vector: Sequence[float]) -> list[float]:
    """Converts a vector from Blender's axes to glTF's axes."""
    x, y, z = vector
    return [x, z, -y]


def z_up(vector: Sequence[float]) -> Vector:
    """Converts a vector from glTF's axes to Blender's axes."""
    x, y, z = vector
    return (x, -z, y)


def _matrix(right: Vector, up: Vector, back: Vector, origin: Vector) -> Matrix:
    rows = [(right[row], up[row], back[row], origin[row]) for row in range(3)]
    return (*rows, (0.0, 0.0, 0.0, 1.0))


def _sum(*vectors: Sequence[float]) -> Vector:
    x, y, z = (sum(parts) for parts in zip(*vectors, strict=True))
    return (x, y, z)


def _times(vector: Sequence[float], factor: float) -> Vector:
    return (vector[0] * factor, vector[1] * factor, vector[2] * factor)


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _cross(a: Sequence[float], b: Sequence[float]) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _unit(vector: Sequence[float]) -> Vector:
    length = math.sqrt(_dot(vector, vector))
    if not (math.isfinite(length) and length > 0.0):
        raise WindowError(f"camera: expected axes that are not zero, found {tuple(vector)}")
    return _times(vector, 1.0 / length)


def _solve(a: Sequence[float], b: Sequence[float], c: Sequence[float], target: Sequence[float]) -> Vector:
    """Solves x a + y b + z c = target for (x, y, z), by Cramer's rule."""
    whole = _dot(_cross(a, b), c)
    return (_dot(_cross(target, b), c) / whole, _dot(_cross(a, target), c) / whole, _dot(_cross(a, b), target) / whole)
