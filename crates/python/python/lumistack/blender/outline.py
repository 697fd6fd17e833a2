"""Outlines around the window in the 3D view, and the effect of dragging them. Lines are pairs of
points of display space, millimetres."""

from __future__ import annotations

import math
from collections.abc import Sequence

Point = tuple[float, float, float]
Line = tuple[Point, Point]

#: Length of the drawn part of the viewing cone, in widths of the window.
CONE = 0.9
#: The depth of field is drawn up to this depth in front of and behind the window, in widths of the
#: window.
MOST_DEPTH = 2.0


def frame(size_mm: Sequence[float], z_mm: float = 0.0, spread: Sequence[float] = (1.0, 1.0)) -> list[Line]:
    """Returns the four edges of the window, moved to a depth and scaled by `spread` (x, y)."""
    x, y = size_mm[0] / 2 * spread[0], size_mm[1] / 2 * spread[1]
    corners: list[Point] = [(-x, y, z_mm), (x, y, z_mm), (x, -y, z_mm), (-x, -y, z_mm)]
    return list(zip(corners, corners[1:] + corners[:1], strict=True))


def spread_at(z_mm: float, distance_mm: float | None) -> float:
    """Returns the width that the middle view shows at a depth z, in widths of the window. It is 1
    in parallel projection, and (D - z)/D for an eye at the distance D."""
    return 1.0 if distance_mm is None else max((distance_mm - z_mm) / distance_mm, 0.0)


def depth_box(size_mm: Sequence[float], depth_mm: Sequence[float] | None, distance_mm: float | None) -> list[Line]:
    """Returns the outline of the depths that the display shows sharply. It has a frame at the
    nearest depth, a frame at the farthest depth, and lines between their corners. Empty if no depth
    is sharp."""
    if depth_mm is None:
        return []
    most = MOST_DEPTH * size_mm[0]
    if distance_mm is not None:
        most = min(most, 0.95 * distance_mm)
    low, high = max(depth_mm[0], -MOST_DEPTH * size_mm[0]), min(depth_mm[1], most)
    ends = [frame(size_mm, z, (spread_at(z, distance_mm),) * 2) for z in (low, high)]
    between: list[Line] = [(a[0], b[0]) for a, b in zip(*ends, strict=True)]
    return [*ends[0], *ends[1], *between]


def cone(size_mm: Sequence[float], fov_deg: Sequence[float]) -> list[Line]:
    """Returns the outline of the viewing zone. The zone's planes go through the window's edges and
    lean outwards by half the field of view."""
    reach = CONE * size_mm[0]
    x, y = size_mm[0] / 2, size_mm[1] / 2
    out_x, out_y = (reach * math.tan(math.radians(angle) / 2) for angle in fov_deg)
    near: list[Point] = [(-x, y, 0.0), (x, y, 0.0), (x, -y, 0.0), (-x, -y, 0.0)]
    far: list[Point] = [(-x - out_x, y + out_y, reach), (x + out_x, y + out_y, reach), (x + out_x, -y - out_y, reach), (-x - out_x, -y - out_y, reach)]
    return [*zip(near, far, strict=True), *zip(far, far[1:] + far[:1], strict=True)]


def slope_of_mouse(mouse_px: Sequence[float], size_px: Sequence[float], fov_deg: Sequence[float]) -> tuple[float, float]:
    """Converts the mouse's position in an area to the slope of a view. The area's edges stand for
    the edges of the field of view. y points up."""
    shares = [2.0 * min(max(place / max(size, 1.0), 0.0), 1.0) - 1.0 for place, size in zip(mouse_px, size_px, strict=True)]
    x, y = (share * math.tan(math.radians(angle) / 2) for share, angle in zip(shares, fov_deg, strict=True))
    return (x, y)


def cage(size: float, shift: Sequence[float], width: float) -> list[float]:
    """Returns the matrix of the frame that the user drags in the 3D view, column by column. `width` is
    the width of the camera's picture in the window's plane, scene units."""
    x, y = (part * width for part in shift)
    return [size, 0.0, 0.0, 0.0, 0.0, size, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, 0.0, 1.0]


def of_cage(matrix: Sequence[float], width: float) -> tuple[float, tuple[float, float]]:
    """Returns size and shift of the window from the matrix of the dragged frame, the inverse of
    `cage`."""
    return abs(matrix[0]), (matrix[12] / width, matrix[13] / width)


def is_in_front(eye_mm: Sequence[float], size_mm: Sequence[float]) -> bool:
    """Returns true if an eye is in front of the window, at a distance of more than a hundredth of
    the window's width."""
    return eye_mm[2] > 0.01 * size_mm[0]


def in_cone(eye_mm: Sequence[float], fov_deg: Sequence[float]) -> bool:
    """Returns true if an eye is in the field of view, seen from the window's centre."""
    if eye_mm[2] <= 0.0:
        return False
    return all(abs(place) <= eye_mm[2] * math.tan(math.radians(angle) / 2) for place, angle in zip(eye_mm, fov_deg, strict=False))


def turned(value: float, step: float, low: float, high: float) -> float:
    """Returns a value after a gizmo (a handle in the 3D view) changed it by `step`, clamped to its
    range."""
    return min(max(value + step, low), high)
