"""Computes SSIM and FLIP of test pictures with the reference tools: scikit-image and flip-evaluator (the tool of FLIP's authors).

usage: metrics_reference.py [MAPS_DIR]

Prints the contents of tests/metrics_reference.json. With MAPS_DIR, also writes every FLIP map there as raw float32.

Pictures are computed by integer formulas of row, column and channel, so that other languages
compute the same code values. Values are code/255, sRGB-encoded. SSIM is the mean over the channels.
If a picture is smaller than SSIM's window, it is mirrored at the edges and all its pixels are
included (win_size=1).
"""
import json
import sys

import numpy as np
from flip_evaluator import evaluate
from skimage.metrics import structural_similarity

M = np.uint64(0xFFFFFFFF)


def noise(seed, rows, cols):
    """Returns code values 0..255 that a hash computes from row and column numbers, [row][col][channel]."""
    r, c, k = np.meshgrid(np.array(rows, np.uint64), np.array(cols, np.uint64), np.arange(3, dtype=np.uint64), indexing="ij")
    h = (r * np.uint64(0x9E3779B1) + c * np.uint64(0x85EBCA77) + k * np.uint64(0xC2B2AE3D) + np.uint64(seed * 0x27D4EB2F)) & M
    h ^= h >> np.uint64(15)
    h = h * np.uint64(0x2C1B3C6D) & M
    h ^= h >> np.uint64(12)
    h = h * np.uint64(0x297A2D39) & M
    h ^= h >> np.uint64(15)
    return (h >> np.uint64(24)).astype(np.int64)


def smooth(seed, rows, cols):
    """Returns a smooth picture: noise at every eighth pixel, with bilinear interpolation between."""
    rows, cols = np.array(rows), np.array(cols)
    fr, fc = (rows % 8)[:, None, None], (cols % 8)[None, :, None]
    corner = lambda dr, dc: noise(seed, rows // 8 + dr, cols // 8 + dc)
    top = (8 - fc) * corner(0, 0) + fc * corner(0, 1)
    bottom = (8 - fc) * corner(1, 0) + fc * corner(1, 1)
    return ((8 - fr) * top + fr * bottom) // 64


def picture(formula, shape):
    """Returns the code values of the test picture "KIND:NUMBER", of shape [rows, cols]."""
    kind, number = formula.split(":")
    number, (rows, cols) = int(number), (range(shape[0]), range(shape[1]))
    if kind == "flat":
        return np.full((*shape, 3), number, np.int64)
    if kind == "noise":
        return noise(number, rows, cols)
    if kind == "smooth":
        return smooth(number, rows, cols)
    if kind == "grainy":  # seven eighths of a smooth picture, one eighth of noise
        return (7 * smooth(number, rows, cols) + noise(number + 100, rows, cols)) // 8
    if kind == "shifted":  # the picture "smooth:1", moved to the left by `number` pixels
        return smooth(1, rows, range(number, shape[1] + number))
    if kind == "checks":
        r, c = np.meshgrid(rows, cols, indexing="ij")
        return np.repeat((255 * ((r // number + c // number) % 2))[..., None], 3, axis=2)
    raise ValueError(formula)


PAIRS = [
    ("equal", [40, 67], "smooth:1", "smooth:1", None),
    ("other smooth", [40, 67], "smooth:1", "smooth:2", None),
    ("grain", [40, 67], "smooth:1", "grainy:1", None),
    ("grain, coarse screen", [40, 67], "smooth:1", "grainy:1", 25.0),
    ("shifted", [61, 32], "smooth:1", "shifted:2", None),
    ("noise", [33, 50], "noise:3", "noise:4", None),
    ("black and white", [24, 24], "flat:0", "flat:255", None),
    ("checks and grey", [48, 30], "checks:2", "flat:128", None),
    ("fine and coarse checks", [30, 48], "checks:1", "checks:5", 120.0),
    ("one pixel", [1, 1], "noise:5", "noise:6", None),
    ("tiny", [5, 3], "smooth:7", "noise:8", None),
    ("tall", [290, 17], "smooth:2", "grainy:2", None),
    ("flat and wide", [9, 200], "smooth:9", "grainy:9", None),
]
SAMPLES = 24

results = []
for index, (name, shape, reference, test, ppd) in enumerate(PAIRS):
    codes = [picture(reference, shape), picture(test, shape)]
    pair = [(code / 255).astype(np.float32) for code in codes]
    parameters = {} if ppd is None else {"ppd": ppd}
    flip_map, flip_mean, used = evaluate(*pair, "LDR", inputsRGB=True, applyMagma=False, parameters=parameters)
    flip_map = np.asarray(flip_map, np.float32).reshape(shape)
    small = {"win_size": 1} if min(shape) < 11 else {}
    ssim = structural_similarity(
        *[code / 255 for code in codes], channel_axis=-1, data_range=1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, **small
    )
    places = sorted({int(i * (flip_map.size - 1) // (SAMPLES - 1)) for i in range(SAMPLES)})
    results.append(
        {
            "name": name,
            "shape": shape,
            "reference": reference,
            "test": test,
            "code_sums": [int(code.sum()) for code in codes],
            "pixels_per_degree": float(used["ppd"]),
            "ssim": round(float(ssim), 8),
            "flip": round(float(flip_mean), 7),
            "flip_at": [[place, round(float(flip_map.flat[place]), 6)] for place in places],
        }
    )
    if len(sys.argv) > 1:
        flip_map.tofile(f"{sys.argv[1]}/flip_{index}.f32")

print("[")
print(",\n".join("  " + json.dumps(result) for result in results))
print("]")
