"""The problem, its geometry and the requests that the peers of `cargo xtask bench factorize` share. Peers are array libraries, which
are compared with Lumistack.

The script of a peer runs the paper's multiplicative update (eq. 16) on arrays of its library. Its argument is a
folder with

    problem.json    pixels, pitch, views, angles, distances of the layers, frames, brightness
    target.npy      L, [view_y][view_x][row][col][rgb]
    layer_N.npy     start of layer N, [frame][row][col][rgb]; layer 0 is the rearmost

The script answers requests. A request is one line of text with fields separated by tabs; an answer is one line of JSON. VARIANT
is the name of one way to write the update:

    save VARIANT FOLDER     makes one update from the start, and writes its masks to FOLDER/layer_N.npy as float32
    update VARIANT          makes one more update
    both answer {"seconds": time for the update}

The script computes the geometry itself from the display's numbers, with oblique views and nearest sampling. It ignores rays
that miss a layer. So the pixels of a layer that a view uses form a rectangle, which is a slice of the layer's array.
"""
import json
import math
import sys
import time

import numpy as np

FLOOR = 1e-4  # smallest mask: the update multiplies, so an exact 0 would stay 0


class Problem:
    """The arrays of the problem. Rows and columns are their last axes, so that slices of rows and columns are short to write."""

    def __init__(self, folder):
        with open(f"{folder}/problem.json") as file:
            about = json.load(file)
        target = np.load(f"{folder}/target.npy") * np.float32(about["brightness"])
        # the target βL, [view_y][view_x][rgb][row][col]
        self.target = np.ascontiguousarray(target.transpose(0, 1, 4, 2, 3))
        # the start of every layer, [frame][rgb][row][col]
        layers = [np.load(f"{folder}/layer_{n}.npy") for n in range(len(about["d_mm"]))]
        self.layers = [np.ascontiguousarray(layer.transpose(0, 3, 1, 2)) for layer in layers]
        self.views = list(views(about))


def views(about):
    """Computes for every view its slice of the target and its slice of every layer."""
    (cols, rows), (view_cols, view_rows) = about["resolution"], about["views"]

    def shifts(a, count, fov_deg):
        slope = (a - (count - 1) / 2) * (2 / count) * math.tan(math.radians(fov_deg) / 2)
        return [math.floor(d_mm * slope / about["pitch_mm"] + 0.5) for d_mm in about["d_mm"]]

    for a_y in range(view_rows):
        down = shifts(a_y, view_rows, about["fov_deg"][1])
        top, bottom = max(0, -min(down)), rows - max(0, max(down))
        for a_x in range(view_cols):
            right = shifts(a_x, view_cols, about["fov_deg"][0])
            start, end = max(0, -min(right)), cols - max(0, max(right))
            field = (a_y, a_x, ..., slice(top, bottom), slice(start, end))
            yield field, [(..., slice(top + y, bottom + y), slice(start + x, end + x)) for x, y in zip(right, down)]


def others(layers, at, n):
    """Returns the slices of all layers except layer n."""
    return [layer[part] for k, (layer, part) in enumerate(zip(layers, at)) if k != n]


def serve(name, threads, variants, array, numpy):
    """Answers requests until standard input ends.

    `variants` are functions by name that make one update. Their arguments are target, layers (changed in place) and
    views. `array` and `numpy` convert NumPy arrays to the library's and back.
    """
    problem = Problem(sys.argv[1])
    target = array(problem.target)
    state = {}
    answer({"name": name, "threads": threads, "variants": list(variants)})
    for line in sys.stdin:
        request, variant, *folder = line.rstrip("\n").split("\t")
        if request == "save":
            state[variant] = [array(layer.copy()) for layer in problem.layers]
        start = time.perf_counter()
        variants[variant](target, state[variant], problem.views)
        seconds = time.perf_counter() - start
        if request == "save":
            for n, layer in enumerate(state[variant]):
                np.save(f"{folder[0]}/layer_{n}.npy", np.ascontiguousarray(numpy(layer).transpose(0, 2, 3, 1)))
        answer({"seconds": seconds})


def answer(message):
    print(json.dumps(message), flush=True)
