"""Compares the depth of a scene with the display's depth of field, and fits it.

The window moves along its normal; if that is not enough, parallax is scaled. Neither changes the
view from the middle. If the window moves back by t, and slopes are scaled by k, then content at
depth z appears at the depth

oblique        k (z + t)
perspective    z' with z'/(D - z') = k y/(D - y),   y = (z + t) D/(D + t)

for eyes at the distance D, as in `crates/shot/src/place.rs`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

#: The depths between these two quantiles are fitted, so that a few stray surfaces have no effect.
ENDS = (0.02, 0.98)
#: Relative distance outside of the sharp depths at which content still counts as sharp, if the
#: sharp depths lie on both sides of the window. A fit moves content exactly to the ends, and
#: Blender stores the fit in single precision.
TOLERANCE = 0.01
#: Smallest factor on parallax. A scene with less parallax looks flat, so a fit rather leaves the
#: farthest content blurred.
LEAST_SCALE = 0.03
#: Fractions of the farthest content that a fit may leave blurred, in the order of the attempts.
LEFT_OUT = (ENDS[0], *(number / 20 for number in range(1, 19)))
#: A warning appears if at least this fraction of the visible content lies outside the sharp depths.
WORTH_SAYING = 0.05


@dataclass(frozen=True)
class Fit:
    """A proposed fit."""

    moved_back_mm: float
    depth_scale: float


def outside(depths_mm: Sequence[float], range_mm: Sequence[float]) -> float:
    """Returns the fraction of the visible content that lies outside `range_mm`, the depths that the
    display shows sharply."""
    if not depths_mm:
        return 0.0
    low, high = (end * (1.0 + TOLERANCE) for end in range_mm) if range_mm[0] < 0.0 < range_mm[1] else range_mm
    return sum(not low <= depth <= high for depth in depths_mm) / len(depths_mm)


def sentence(depths_mm: Sequence[float], range_mm: Sequence[float] | None) -> str | None:
    """Returns the warning for a scene that is too deep; None if the scene fits, or has no visible
    content."""
    if not depths_mm:
        return None
    if range_mm is None:
        return "There is no depth at which the display shows detail as fine as its own pixels"
    share = outside(depths_mm, range_mm)
    if share < WORTH_SAYING:
        return None
    (low, high), (near, far) = range_mm, (max(depths_mm), min(depths_mm))
    return (
        f"{100 * share:.0f} % of the visible surfaces are blurred: the scene reaches from {place(far)} to {place(near)} the display, "
        f"but the display is sharp only from {place(low)} to {place(high)} its plane"
    )


def place(depth_mm: float) -> str:
    """Returns a text about a depth, without the noun: "60 mm behind"."""
    side = "behind" if depth_mm < 0.0 else "in front of"
    return f"far {side}" if math.isinf(depth_mm) else f"{abs(depth_mm):.0f} mm {side}"


def moved(fit: Fit) -> str:
    """Returns a sentence about a fit."""
    by = f"{abs(fit.moved_back_mm):.0f} mm"
    way = "back" if fit.moved_back_mm > 0.0 else "forward"
    window = "The window stays in place" if by == "0 mm" else f"The window moved {way} by {by}"
    depth = "the depth is unchanged" if fit.depth_scale == 1.0 else f"depth is shown at {100 * fit.depth_scale:.0f} %"
    return f"{window}; {depth}"


def shown_at(depth_mm: float, fit: Fit, distance_mm: float | None) -> float:
    """Returns the depth at which content at `depth_mm` appears after the fit."""
    if distance_mm is None:
        return fit.depth_scale * (depth_mm + fit.moved_back_mm)
    moved = (depth_mm + fit.moved_back_mm) * distance_mm / (distance_mm + fit.moved_back_mm)
    parallax = fit.depth_scale * moved / (distance_mm - moved)
    return distance_mm * parallax / (1.0 + parallax)


def in_scene(range_mm: Sequence[float] | None, depth_scale: float, distance_mm: float | None) -> tuple[float, float] | None:
    """Returns the range of depths that appear within `range_mm` after parallax is scaled."""
    if range_mm is None:
        return None
    if distance_mm is None:
        low, high = (depth / depth_scale for depth in range_mm)
        return low, high
    # parallax z / (D - z) tends to -1 for content infinitely far behind the window
    parallax = (-1.0 if depth == -math.inf else _parallax(depth, distance_mm) / depth_scale for depth in range_mm)
    low, high = (-math.inf if part <= -1.0 else distance_mm * part / (1.0 + part) for part in parallax)
    return low, high


def better_fit(depths_mm: Sequence[float], range_mm: Sequence[float], distance_mm: float | None, compress: bool, now: Fit) -> Fit | None:
    """Returns the fit that shows more of the scene sharply than `now`; None if there is none.
    `depths_mm` are depths without any fit."""

    def blurred(fit: Fit) -> float:
        return outside([shown_at(depth, fit, distance_mm) for depth in depths_mm], range_mm)

    fit = best_fit(depths_mm, range_mm, distance_mm, compress)
    return fit if blurred(fit) < blurred(now) else None


def best_fit(depths_mm: Sequence[float], range_mm: Sequence[float], distance_mm: float | None, compress: bool) -> Fit:
    """Returns the movement of the window that brings most of the depths into the range. With
    `compress` the function also returns the scale of parallax that brings in the remaining depths.

    If this scale would be below `LEAST_SCALE`, the fit leaves out as little of the farthest content
    as possible, for instance a far backdrop. If no fit suffices, the scale is `LEAST_SCALE`."""
    ordered = sorted(depth for depth in depths_mm if math.isfinite(depth))
    if not ordered:
        return Fit(0.0, 1.0)
    fits = (_fit(ordered, left_out, range_mm, distance_mm, compress) for left_out in LEFT_OUT)
    first = next(fits)
    if first.depth_scale >= LEAST_SCALE:
        return first
    return next((fit for fit in fits if fit.depth_scale >= LEAST_SCALE), Fit(first.moved_back_mm, LEAST_SCALE))


def _fit(ordered: Sequence[float], left_out: float, range_mm: Sequence[float], distance_mm: float | None, compress: bool) -> Fit:
    """Returns the fit of the depths without the fraction `left_out` of the farthest ones."""
    far, near = (ordered[round(share * (len(ordered) - 1))] for share in (left_out, ENDS[1]))
    low, high = range_mm
    wanted = (low + high) / 2
    if distance_mm is None:
        fit = Fit(wanted - (far + near) / 2, 1.0)
    else:
        # The wanted movement brings the mean of the nearest and farthest depth to the middle of the
        # range. This mean grows with the movement, so bisection finds the movement.
        least, most = -0.9 * distance_mm, 100.0 * (abs(far) + abs(near) + abs(wanted) + distance_mm)
        for _ in range(200):
            by = (least + most) / 2
            middle = (shown_at(far, Fit(by, 1.0), distance_mm) + shown_at(near, Fit(by, 1.0), distance_mm)) / 2
            least, most = (by, most) if middle < wanted else (least, by)
        fit = Fit((least + most) / 2, 1.0)
    if not (compress and low < 0.0 < high):
        return fit
    scale = 1.0
    for end in (far, near):
        shown = shown_at(end, fit, distance_mm)
        limit = low if shown < 0.0 else high
        if abs(shown) > abs(limit):
            scale = min(scale, _parallax(limit, distance_mm) / _parallax(shown, distance_mm))
    return Fit(fit.moved_back_mm, scale)


def _parallax(depth_mm: float, distance_mm: float | None) -> float:
    return depth_mm if distance_mm is None else depth_mm / (distance_mm - depth_mm)
