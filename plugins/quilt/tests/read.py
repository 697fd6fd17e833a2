"""Prints as JSON the pixels of every view of a quilt, and the layout that its name
declares."""

import json
import re
import sys
from pathlib import Path

from PIL import Image

path = Path(sys.argv[1])
columns, rows, aspect = re.search(r"_qs(\d+)x(\d+)a([\d.]+)\.png$", path.name).groups()
columns, rows = int(columns), int(rows)
picture = Image.open(path)
width, height = picture.width // columns, picture.height // rows
views = []
for row in range(rows):
    for column in range(columns):
        left, lower = column * width, picture.height - row * height
        tile = picture.crop((left, lower - height, left + width, lower))
        views.append([sample for pixel in tile.get_flattened_data() for sample in pixel])
json.dump({"mode": picture.mode, "size": picture.size, "aspect": float(aspect), "tile": [width, height], "views": views}, sys.stdout)
