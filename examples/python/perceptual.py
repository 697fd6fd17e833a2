"""Measures how visible the errors of displays are, by ColorVideoVDP.

    pip install cvvdp                                               # brings PyTorch, some gigabytes
    python examples/python/perceptual.py runs/three-layer           # one display
    python examples/python/perceptual.py runs/figure-9              # all displays of a run, nodes/*

The program compares the views that a display shows with the target's views, and prints two scores. The first
treats views as still pictures, and is the mean over all views. The second is for a viewer who walks past from
left to right: the views of the middle row are the frames of a video. The unit is the JOD. A score of 10 means no visible
difference, and 75 of 100 people notice a difference of 1. See Mantiuk et al., ColorVideoVDP, SIGGRAPH 2024.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pycvvdp
import torch
from numpy.typing import NDArray

import lumistack


def codes(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Encodes linear light as sRGB code values."""
    clipped = np.clip(linear.astype(np.float64), 0.0, 1.0)
    encoded = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return np.round(255.0 * encoded).astype(np.uint8)


def metric(light_field: lumistack.LightField, white: float, distance_mm: float) -> Any:
    """Makes ColorVideoVDP for the light field's pixels, seen from `distance_mm` in a dark room."""
    _, _, rows, cols, _ = light_field.shape
    pixel_deg = float(np.degrees(np.arctan(light_field.pitch_mm / distance_mm)))
    geometry = pycvvdp.vvdp_display_geometry((cols, rows), ppd=1.0 / pixel_deg)
    photometry = pycvvdp.vvdp_display_photo_eotf(white, contrast=1000, source_colorspace="sRGB")
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return pycvvdp.cvvdp(display_photometry=photometry, display_geometry=geometry, quiet=True, device=device)


def displays(run: Path) -> list[tuple[str, Path]]:
    """Finds the folders of a run that contain patterns, with their names."""
    nodes = sorted(folder for folder in (run / "nodes").glob("*") if (folder / "layers").is_dir())
    return [(folder.name, folder) for folder in nodes] or [(run.name, run)]


def main() -> None:
    parser = argparse.ArgumentParser(description="Measures how visible the errors of displays are, by ColorVideoVDP.")
    parser.add_argument("run", type=Path, nargs="+", help="a run folder")
    parser.add_argument("--white", type=float, default=200.0, help="luminance of white at the eye, cd/m²")
    parser.add_argument("--distance-mm", type=float, default=1000.0, help="the viewer's distance")
    parser.add_argument("--fps", type=float, default=30.0, help="number of views per second that the walking viewer sees")
    arguments = parser.parse_args()
    # Compare each display's views with the target's: one by one, and as the video of a walk.
    for run in arguments.run:
        target = lumistack.LightField.open(run)
        vdp = metric(target, arguments.white, arguments.distance_mm)
        wanted = codes(target.radiance)
        for name, folder in displays(run):
            stack = lumistack.LayerStack.open(folder)
            shown = codes(stack.views(target).radiance)
            stills = [
                float(vdp.predict(shown[y, x], wanted[y, x], dim_order="HWC")[0])
                for y in range(shown.shape[0])
                for x in range(shown.shape[1])
            ]
            middle = shown.shape[0] // 2
            walk, _ = vdp.predict(shown[middle], wanted[middle], dim_order="FHWC", frames_per_second=arguments.fps)
            psnr = stack.psnr(target)
            print(f"{name:24} {np.mean(stills):5.2f} JOD still, {float(walk):5.2f} JOD walking past; PSNR {psnr:.1f} dB")


if __name__ == "__main__":
    main()
