"""Compares views of Gaussian splats with views by Mitsuba 3 (`ellipsoids`, `volprim_rf_basic`), along the same rays.

splats_mitsuba.py FOLDER

The two programs differ in three ways. Mitsuba sorts the ellipsoids on every ray by the points where the ray enters them. It takes
the largest value of each Gaussian along the ray, and stops a ray when its transmittance falls to 1 %. Lumistack projects whole
splats, sorts them by their centres, and filters by a pixel's box. In the cases named `apart`, which have separate splats, order and
projection make no difference, so the pictures must agree to LEAST_APART dB. Where thousands of splats overlap, the different
orders limit the agreement, so only LEAST_CAPTURE dB are required.
"""

import json
import math
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

# Mitsuba needs a variant before any other call
mi.set_variant("llvm_ad_rgb")

LEAST_APART = 60.0
LEAST_CAPTURE = 36.0
# number of rays per pixel along each axis
RAYS = 4


def rays(case, slope):
    """Computes origins and directions of all rays of a view, pixel by pixel: x right, y up, z towards the viewer."""
    rows, cols, pitch = case["rows"], case["cols"], case["pitch_mm"]
    offsets = (np.arange(RAYS) + 0.5) / RAYS - 0.5
    row, col, i, j = np.meshgrid(np.arange(rows), np.arange(cols), offsets, offsets, indexing="ij")
    at = np.stack([(col + j - 0.5 * (cols - 1)) * pitch, (0.5 * (rows - 1) - row - i) * pitch, np.zeros_like(i)], -1).reshape(-1, 3)
    if case["eye_mm"] is None:
        to = np.broadcast_to([slope[0], slope[1], 1.0], at.shape)
        origins = at + 200.0 * to
    else:
        origins = np.broadcast_to([slope[0] * case["eye_mm"], slope[1] * case["eye_mm"], case["eye_mm"]], at.shape)
    directions = at - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def vector(kind, rows):
    return kind(*(mi.Float(np.ascontiguousarray(rows[:, axis], np.float32)) for axis in range(3)))


def render(case, scene, integrator, slope):
    origins, directions = rays(case, slope)
    ray = mi.Ray3f(vector(mi.Point3f, origins), vector(mi.Vector3f, directions))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, len(origins))
    light = integrator.sample(dr.ADMode.Primal, scene, sampler, ray, None, None, mi.Bool(True))[0]
    return np.array(light).T.reshape(case["rows"], case["cols"], RAYS * RAYS, 3).mean(axis=2)


def main():
    folder = Path(sys.argv[1])
    integrator = mi.load_dict({"type": "volprim_rf_basic", "srgb_primitives": False, "max_depth": 4096})
    print(f"\nMitsuba {mi.__version__}, {RAYS * RAYS} rays per pixel\n\n| case | view | agreement, dB |\n|---|---|---|")
    failed = False
    for case in json.loads((folder / "cases.json").read_text()):
        splats = np.fromfile(folder / case["splats"], np.float32).reshape(case["count"], -1)
        parts = {"centers": splats[:, :3], "scales": splats[:, 3:6], "quaternions": splats[:, 6:10], "opacities": splats[:, 10:11], "sh_coeffs": splats[:, 11:]}
        tensors = {name: mi.TensorXf(np.ascontiguousarray(values)) for name, values in parts.items()}
        scene = mi.load_dict({"type": "scene", "splats": {"type": "ellipsoids", **tensors}})
        least = LEAST_APART if case["name"].startswith("apart") else LEAST_CAPTURE
        for view in case["views"]:
            ours = np.fromfile(folder / view["ours"], np.float32).reshape(case["rows"], case["cols"], 4)[..., :3]
            theirs = render(case, scene, integrator, view["slope"])
            quality = -10 * math.log10(float(np.mean((ours - theirs) ** 2)))
            failed |= quality < least
            print(f"| {case['name']} | {view['slope']} | {quality:.1f} |")
            np.save(folder / (view["ours"] + ".mitsuba.npy"), theirs)
    if failed:
        sys.exit(f"expected at least {LEAST_APART} dB for separate splats and {LEAST_CAPTURE} dB for the others, found less; see the table")


main()
