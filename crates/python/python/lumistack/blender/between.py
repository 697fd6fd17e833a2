"""Directions between a display's views, and the score in these directions.

The solver sees only the views, so its own error says little about other directions. Halfway between
two neighbouring views the error is the largest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Score:
    """PSNR of seen pictures, dB: over all directions, and in the worst direction."""

    psnr_zone: float
    worst: float
    directions: int

    def text(self) -> str:
        if self.directions == 0:
            return "not scored between the views"
        return f"{self.psnr_zone:.1f} dB between the views (worst of {self.directions} directions {self.worst:.1f} dB)"


#: The result if nothing was scored.
UNKNOWN = Score(math.nan, math.nan, 0)


def directions(slopes: Sequence[float], most: int, reach: float = 1.0) -> list[float]:
    """Returns at most `most` slopes at equal distances, each halfway between two of the views'
    slopes. They are symmetric, and reach over the fraction `reach` of the zone, if possible. A
    single view has no neighbour, so then its own slope is returned."""
    halfway = [(left + right) / 2 for left, right in zip(slopes, slopes[1:], strict=False)]
    if not halfway:
        return list(slopes)
    last = len(halfway) - 1
    for count in range(min(most, len(halfway)), 1, -1):
        # The first index is (last - stride (count - 1)) / 2, which must be a whole number.
        # If no symmetric set has the wanted width, a narrower set is better than a wider set.
        most_stride = last // (count - 1)
        wanted = max(int(reach * last / (count - 1)), 1)
        for stride in [*range(wanted, 0, -1), *range(wanted + 1, most_stride + 1)]:
            rest = last - stride * (count - 1)
            if rest >= 0 and rest % 2 == 0:
                return halfway[rest // 2 :: stride][:count]
    return [halfway[last // 2]]


def beside_middle(slopes: Sequence[float]) -> float:
    """Returns the slope halfway between two views that is nearest to straight ahead; of two such
    slopes the one to the right or up."""
    halfway = [(left + right) / 2 for left, right in zip(slopes, slopes[1:], strict=False)]
    return min(halfway or slopes, key=lambda slope: (round(abs(slope), 9), -slope))


def score(found: Sequence[Mapping[str, Any]]) -> Score:
    """Returns the score from results of `LayerStack.psnr_zone` for the same directions.

    One result is the score against one render. Three results are for two renders with independent
    noise and for their mean. Let a, b and m be their mean squared errors. Then 2 m - (a + b)/2 is the
    mean product of the two renders' differences, which is the squared error without their noise.
    """
    errors = [[10.0 ** (-psnr / 10.0) for _, psnr in each["directions"]] for each in found]
    if not errors[0]:
        return UNKNOWN
    if len(errors) == 3:
        errors = [[max(2.0 * both - (one + other) / 2.0, 0.0) for one, other, both in zip(*errors, strict=True)]]
    of = errors[0]
    return Score(_psnr(sum(of) / len(of)), _psnr(max(of)), len(of))


def _psnr(error: float) -> float:
    return math.inf if error <= 0.0 else -10.0 * math.log10(error)
