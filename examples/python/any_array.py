"""Draws a light field with NumPy and compares the solvers on it. Any array can be a light field.

    python examples/python/any_array.py
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import lumistack


def discs(display: lumistack.Display) -> NDArray[np.float32]:
    """Draws coloured discs at several depths in front of a striped wall.

    Returns radiance [view_y, view_x, row, col, rgb].
    """
    slope_x, slope_y = (np.array(slopes) for slopes in display.slopes)
    _, _, rows, cols, _ = display.light_field_shape
    pitch = display.pitch_mm
    x = (np.arange(cols) - (cols - 1) / 2) * pitch
    y = ((rows - 1) / 2 - np.arange(rows)) * pitch

    def seen(z: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the coordinates at which the rays of all views intersect the plane at depth z. A ray of
        slope s through the point x of the display plane has the coordinate x + z·s."""
        return (
            (x[None, :] + z * slope_x[:, None])[None, :, None, :],
            (y[None, :] + z * slope_y[:, None])[:, None, :, None],
        )

    wall_x, wall_y = seen(-30.0)
    stripes = 0.5 + 0.3 * np.sin(0.25 * wall_x + 0.1 * wall_y)
    radiance = stripes[..., None] * np.array([0.6, 0.7, 0.8])
    width, height = cols * pitch, rows * pitch
    for place, z, colour in (
        ((-0.25, 0.1), -15.0, (0.9, 0.3, 0.1)),
        ((0.05, -0.1), 0.0, (0.2, 0.8, 0.3)),
        ((0.28, 0.15), 20.0, (0.2, 0.4, 0.95)),
    ):
        disc_x, disc_y = seen(z)
        inside = np.hypot(disc_x - place[0] * width, disc_y - place[1] * height) < 0.16 * height
        radiance = np.where(inside[..., None], np.array(colour), radiance)
    result: NDArray[np.float32] = radiance.astype(np.float32)
    return result


def main() -> None:
    display = lumistack.Display("paper-three-layer", resolution=(160, 100), frames=6)
    light_field = lumistack.LightField(discs(display), display=display)
    for solver in ("multiplicative", "block-exact", "extrapolated"):
        stack = lumistack.factorize(light_field, solver=solver, iterations=20)
        curve = "  ".join(f"{psnr:.1f}" for _, _, psnr in stack.history[::5])
        print(f"{solver:15} {curve} dB")
    eyes = [{"eye_mm": (side * 32.0, 0.0, 600.0), "sigma_mm": 12.0} for side in (-1, 1)]
    stack = lumistack.factorize(light_field, iterations=20, eyes=eyes)
    print(f"for two eyes    {stack.psnr(light_field):.1f} dB over all views")


if __name__ == "__main__":
    main()
