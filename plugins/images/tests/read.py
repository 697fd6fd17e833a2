"""Reads the files of a folder with NumPy, Pillow and OpenEXR's own bindings; prints their content as
JSON.
"""

import json
import sys
from pathlib import Path

import numpy
import OpenEXR
from PIL import Image

folder = Path(sys.argv[1])
found = {}
for path in sorted(folder.glob("*.npz")):
    with numpy.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    assert all(array.dtype == numpy.float32 for array in arrays.values()), arrays
    found[path.name] = {
        name: {"shape": array.shape, "values": array.ravel().astype(float).tolist()} for name, array in arrays.items()
    }
for name in ["atlas.png", "swing.png"]:
    if not (folder / name).exists():
        continue
    with Image.open(folder / name) as picture:
        entry = {"size": picture.size, "mode": picture.mode, "frames": getattr(picture, "n_frames", 1)}
        if entry["frames"] == 1:
            entry["pixels"] = numpy.asarray(picture).ravel().tolist()
        else:
            entry["loop"] = picture.info["loop"]
            entry["duration_ms"] = picture.info["duration"]
            entry["pixels"] = []
            for frame in range(entry["frames"]):
                picture.seek(frame)
                entry["pixels"].append(numpy.asarray(picture.convert("RGB")).ravel().tolist())
    found[name] = entry
if (folder / "views.exr").exists():
    with OpenEXR.File(str(folder / "views.exr"), separate_channels=True) as file:
        header, channels = file.header(), file.channels()
        names = list(header["multiView"])
        views = {}
        for index, name in enumerate(names):
            prefix = "" if index == 0 else f"{name}."
            rgb = [channels[prefix + channel].pixels.astype(float) for channel in "RGB"]
            views[name] = numpy.stack(rgb, axis=-1).ravel().tolist()
        assert len(channels) == 3 * len(names), sorted(channels)
    found["views.exr"] = {"multiView": names, "views": views}
json.dump(found, sys.stdout)
