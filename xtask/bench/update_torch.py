"""The paper's multiplicative update in PyTorch on the CPU, on shifted slices of tensors and without gradients.

`worker.py` describes the requests.
"""
from functools import reduce
from operator import mul

import torch
import worker
from worker import FLOOR, others


def whole_arrays(target, layers, views):
    """Updates all frames in one tensor operation, which is the shortest code."""
    for n in range(len(layers)):
        above, below = torch.zeros_like(layers[n]), torch.zeros_like(layers[n])
        for field, at in views:
            product = reduce(mul, others(layers, at, n))
            emitted = (product * layers[n][at[n]]).mean(dim=0)
            above[at[n]].addcmul_(product, target[field])
            below[at[n]].addcmul_(product, emitted)
        layers[n] = (layers[n] * above / below).clamp_(FLOOR, 1)


def frame_by_frame(target, layers, views):
    """Updates one frame after another, so that the temporary tensors fit into the processor's cache."""
    frames = len(layers[0])
    for n in range(len(layers)):
        above, below = torch.zeros_like(layers[n]), torch.zeros_like(layers[n])
        for field, at in views:
            wanted = target[field]
            emitted, products = torch.zeros_like(wanted), []
            for m in range(frames):
                product = reduce(mul, others([layer[m] for layer in layers], at, n))
                emitted.addcmul_(product, layers[n][m][at[n]])
                products.append(product)
            emitted *= 1 / frames
            for m, product in enumerate(products):
                above[m][at[n]].addcmul_(product, wanted)
                below[m][at[n]].addcmul_(product, emitted)
        layers[n] = (layers[n] * above / below).clamp_(FLOOR, 1)


variants = {"whole arrays": whole_arrays, "frame by frame": frame_by_frame}
with torch.no_grad():
    threads = torch.get_num_threads()
    worker.serve(f"PyTorch {torch.__version__}", threads, variants, array=torch.from_numpy, numpy=lambda a: a.numpy())
