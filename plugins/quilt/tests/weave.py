"""Computes the native picture from a quilt and a calibration by NumPy.

Prints the number of samples that differ from the picture NATIVE, the number of all samples, and the
picture's width and height.

usage: weave.py CALIBRATION QUILT NATIVE
"""

import json
import re
import sys

import numpy
from PIL import Image

calibration = json.load(open(sys.argv[1]))
quilt = numpy.asarray(Image.open(sys.argv[2]))
native = numpy.asarray(Image.open(sys.argv[3]))
columns, rows = map(int, re.search(r"_qs(\d+)x(\d+)", sys.argv[2]).groups())
value = lambda key, otherwise=0.0: calibration.get(key, {"value": otherwise})["value"]
width, height, slope = int(value("screenW")), int(value("screenH")), value("slope")
sign = -1 if value("flipImageX") else 1
periods = value("pitch") * width / value("DPI") * numpy.cos(numpy.arctan(1 / slope))
tilt = sign * height / (width * slope)
x, y = numpy.meshgrid(numpy.arange(width), numpy.arange(height))  # y from the bottom
u, v = (x + 0.5) / width, (y + 0.5) / height
parity = {0: 0 * x, 1: (x + y) % 2, 2: x % 2, 3: (y + x % 2 * 2) % 4, 4: y % 2}[int(value("CellPatternMode"))]
count, (tile_w, tile_h) = columns * rows, (quilt.shape[1] // columns, quilt.shape[0] // rows)
woven = numpy.zeros((height, width, 3), numpy.uint8)
for channel in range(3):
    place = 2 - channel if value("flipSubp") else channel
    du, dv = sign * place / (3 * width), 0.0
    if cells := calibration.get("subpixelCells"):
        offset = lambda axis: numpy.array([cell["RGB"[place] + "Offset" + axis] for cell in cells])[parity]
        du, dv = offset("X") / width, offset("Y") / height
    phase = ((u + du + (v + dv) * tilt) * periods - value("center")) % 1.0
    view = numpy.minimum((1 - phase if value("invView") else phase) * count, count - 1).astype(int)
    # Tiles are counted from the bottom left, but rows of the picture from the top.
    column = view % columns * tile_w + (u * tile_w).astype(int)
    row = quilt.shape[0] - 1 - (view // columns * tile_h + (v * tile_h).astype(int))
    woven[:, :, channel] = quilt[row, column, channel]
print(numpy.count_nonzero(woven[::-1] != native), native.size, native.shape[1], native.shape[0])
