"""The paper's multiplicative update in NumPy, on shifted slices of arrays. `worker.py` describes the requests."""
from functools import reduce
from operator import mul

import numpy as np
import worker
from worker import FLOOR, others


def whole_arrays(target, layers, views):
    """Updates all frames in one array operation, which is the shortest code."""
    for n in range(len(layers)):
        above, below = np.zeros_like(layers[n]), np.zeros_like(layers[n])
        for field, at in views:
            product = reduce(mul, others(layers, at, n))
            emitted = (product * layers[n][at[n]]).mean(axis=0)
            above[at[n]] += product * target[field]
            below[at[n]] += product * emitted
        layers[n] = np.clip(layers[n] * above / below, FLOOR, 1)


def frame_by_frame(target, layers, views):
    """Updates one frame after another, so that the temporary arrays fit into the processor's cache."""
    frames = len(layers[0])
    for n in range(len(layers)):
        above, below = np.zeros_like(layers[n]), np.zeros_like(layers[n])
        for field, at in views:
            wanted = target[field]
            emitted, products = np.zeros_like(wanted), []
            for m in range(frames):
                product = reduce(mul, others([layer[m] for layer in layers], at, n))
                emitted += product * layers[n][m][at[n]]
                products.append(product)
            emitted *= 1 / frames
            for m, product in enumerate(products):
                above[m][at[n]] += product * wanted
                below[m][at[n]] += product * emitted
        layers[n] = np.clip(layers[n] * above / below, FLOOR, 1)


variants = {"whole arrays": whole_arrays, "frame by frame": frame_by_frame}
worker.serve(f"NumPy {np.__version__}", 1, variants, array=lambda a: a, numpy=lambda a: a)
