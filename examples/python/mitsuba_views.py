"""Renders views with Mitsuba 3 and factorizes them with Lumistack.

    pip install mitsuba
    python examples/python/mitsuba_views.py out

The display is a window at z = 0 of Mitsuba's Cornell box. A pinhole camera at the distance D in front
of the window renders the view of slope s. The camera is at D·s beside the window's middle and looks
straight ahead. Its principal point is shifted so that the film covers exactly the window.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

import lumistack

#: Scene units per millimetre of the display.
SCENE_PER_MM = 0.02
#: Distance of the eyes from the window, millimetres: 3.9 scene units, the distance of the scene's
#: own camera.
DISTANCE_MM = 195.0


def camera(display: lumistack.Display, slope: tuple[float, float], samples: int) -> dict[str, Any]:
    _, _, rows, cols, _ = display.light_field_shape
    width_mm, height_mm = cols * display.pitch_mm, rows * display.pitch_mm
    eye_mm = (DISTANCE_MM * slope[0], DISTANCE_MM * slope[1])
    x, y, z = (SCENE_PER_MM * part for part in (*eye_mm, DISTANCE_MM))
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(0.5 * width_mm / DISTANCE_MM))),
        # shift of the film's middle from the camera's axis, as fractions of the film's size
        "principal_point_offset_x": -eye_mm[0] / width_mm,
        "principal_point_offset_y": eye_mm[1] / height_mm,
        "to_world": mi.ScalarTransform4f().look_at(origin=[x, y, z], target=[x, y, 0], up=[0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": cols,
            "height": rows,
            "pixel_format": "rgb",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": samples},
    }


def render(display: lumistack.Display, scene: Any, samples: int) -> NDArray[np.float32]:
    """Renders all views of a display. Returns linear radiance [view_y, view_x, row, col, rgb]."""
    radiance = np.empty(display.light_field_shape, np.float32)
    slope_x, slope_y = display.slopes
    for view_y, s_y in enumerate(slope_y):
        for view_x, s_x in enumerate(slope_x):
            sensor = mi.load_dict(camera(display, (s_x, s_y), samples))
            seed = view_y * len(slope_x) + view_x
            radiance[view_y, view_x] = np.asarray(mi.render(scene, sensor=sensor, spp=samples, seed=seed))
            print(f"\rview {seed + 1} of {len(slope_x) * len(slope_y)}", end="", flush=True)
    print()
    return radiance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--samples", type=int, default=64)
    arguments = parser.parse_args()
    mi.set_variant("llvm_ad_rgb" if "llvm_ad_rgb" in mi.variants() and has_llvm() else "scalar_rgb")

    # Define a new display: three layers, 12 mm apart, for eyes at DISTANCE_MM.
    size = {"resolution": (160, 120), "pitch_mm": 0.7}
    display = lumistack.Display(
        {
            "name": "three layers in a Cornell box",
            "frames": 6,
            "refresh_hz": 360.0,
            "brightness": 0.4,
            "field": {**size, "views": (5, 5), "fov_deg": (16, 16), "projection": "perspective", "distance_mm": DISTANCE_MM},
            "layers": [{"d_mm": d, **size} for d in (-12.0, 0.0, 12.0)],
        }
    )
    # Render the display's views with Mitsuba's own scene.
    box = mi.cornell_box()
    del box["sensor"]
    radiance = render(display, mi.load_dict(box), arguments.samples)

    # Apply the same exposure to all views, and clip values above 1.
    radiance = np.minimum(radiance * (0.9 / np.quantile(radiance.max(axis=-1), 0.98)), 1.0)
    light_field = lumistack.LightField(radiance, display=display)
    stack = lumistack.factorize(light_field, iterations=30)
    print(stack)
    stack.save(arguments.folder)
    lumistack.write(stack, "images", arguments.folder / "images")
    lumistack.write(stack, "web_simulator", arguments.folder / "preview", target=light_field)
    report = lumistack.report(stack, light_field, arguments.folder, title="Cornell box, rendered by Mitsuba 3")
    print(f"{report['psnr_view']:.1f} dB: {arguments.folder / 'report.html'}")


def has_llvm() -> bool:
    """Returns true if Mitsuba's vectorized variants find the LLVM library that they need."""
    try:
        import drjit

        return bool(drjit.has_backend(drjit.JitBackend.LLVM))
    except ImportError:
        return False


if __name__ == "__main__":
    main()
