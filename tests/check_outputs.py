"""Checks with independent software that a run's outputs agree with their manifests; prints the number of files that each reader opened.

usage: check_outputs.py RUN_DIR
"""
import base64
import configparser
import json
import re
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

run = Path(sys.argv[1])
opened = {}


def count(reader):
    opened[reader] = opened.get(reader, 0) + 1


def check(file, what, found, expected):
    if found != expected:
        sys.exit(f"{file}: {what}: expected {expected}, found {found}")


def png(file, size, bits):
    header = file.read_bytes()[:33]
    check(file, "bits", struct.unpack(">IIBB", header[16:26])[2], bits)
    with Image.open(file) as picture:
        picture.load()
        check(file, "size", picture.size, size)
        check(file, "mode", picture.mode, "RGB")
    count("Pillow")


def exr(file, size):
    with OpenEXR.File(str(file)) as picture:
        for name, channel in picture.channels().items():
            check(file, f"size of {name}", channel.pixels.shape[1::-1], size)
            if not np.isfinite(channel.pixels.astype(float)).all():
                sys.exit(f"{file}: {name} is not finite")
        count("OpenEXR")
        return dict(picture.header()), list(picture.channels())


def images(folder):
    manifest = json.loads((folder / "images.json").read_text())
    told = {entry["file"] for entry in manifest["files"]} | {"images.json", "atlas.json", "hci/parameters.cfg", "hci/gt_disp_lowres.pfm"}
    there = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file() and path.name[0] != "."}
    check(folder, "files that the manifest does not list", sorted(there - told), [])
    for entry in manifest["files"]:
        file, kind = folder / entry["file"], entry["content"]
        size = (entry.get("width"), entry.get("height"))
        if file.suffix == ".npz":
            check(file, "arrays", sorted(np.load(file).keys()), sorted(entry["names"]))
            count("NumPy")
        elif kind == "animation":
            with Image.open(file) as picture:
                check(file, "size", picture.size, size)
                check(file, "pictures", picture.n_frames, len(entry["slopes"]))
                milliseconds = 1000 / entry["pictures_per_second"]
                check(file, "duration", round(picture.info["duration"], 3), round(milliseconds, 3))
                picture.seek(picture.n_frames - 1)
                picture.load()
            count("Pillow")
        elif kind == "views":
            header, channels = exr(file, size)
            check(file, "multiView", header["multiView"], [view["name"] for view in entry["views"]])
            check(file, "views", len(channels), len(entry["views"]))
        elif file.suffix == ".exr":
            exr(file, size)
        else:
            png(file, size, entry.get("bits", 8))
    atlas = folder / "atlas.json"
    if atlas.is_file():
        tiles = json.loads(atlas.read_text())
        sheet = Image.open(folder / tiles["file"])
        for tile in tiles["tiles"]:
            box = (tile["x"], tile["y"], tile["x"] + tile["width"], tile["y"] + tile["height"])
            single = folder / f"layer_{tile['layer']}_frame_{tile['frame']:02}.png"
            check(single, "difference from its place in the atlas", sheet.crop(box).tobytes() == Image.open(single).tobytes(), True)
    if (folder / "hci").is_dir():
        config = configparser.ConfigParser()
        config.read(folder / "hci/parameters.cfg")
        cameras = config.getint("extrinsics", "num_cams_x") * config.getint("extrinsics", "num_cams_y")
        names = [f"input_Cam{n:03}.png" for n in range(cameras)] + ["parameters.cfg", "gt_disp_lowres.pfm"]
        check(folder / "hci", "files", sorted(path.name for path in (folder / "hci").iterdir()), sorted(names))
        size = tuple(config.getint("intrinsics", f"image_resolution_{axis}_px") for axis in "xy")
        check(folder / "hci", "size", Image.open(folder / "hci/input_Cam000.png").size, size)
        head, shape, scale, data = (folder / "hci/gt_disp_lowres.pfm").read_bytes().split(b"\n", 3)
        check(folder / "hci", "map", (head, tuple(map(int, shape.split())), float(scale)), (b"Pf", size, -1.0))
        # Only the light field of a rendered scene states the depth of the middle view, from which
        # the disparities are computed.
        disparities = np.frombuffer(data, "<f4")
        known = disparities[np.isfinite(disparities)]
        check(folder / "hci", "number of disparities", (disparities.size, known.size > 0), (size[0] * size[1], True))
        for key, limit in [("disp_min", known.min()), ("disp_max", known.max())]:
            check(folder / "hci", key, round(config.getfloat("meta", key), 3), round(float(limit), 3))
    for path in (folder / "stanford").glob("*"):
        if not re.fullmatch(r"out_\d\d_\d\d_-?\d+\.\d+_-?\d+\.\d+\.png", path.name):
            sys.exit(f"{path}: expected a file name of the Stanford archive, found another")


def quilt(folder):
    for entry in json.loads((folder / "quilt.json").read_text())["files"]:
        file = folder / entry["quilt"]
        png(file, (entry["width"], entry["height"]), 8)
        columns, rows, aspect = re.search(r"_qs(\d+)x(\d+)a([\d.]+)\.png$", file.name).groups()
        check(file, "grid", [int(columns), int(rows)], [entry["columns"], entry["rows"]])
        check(file, "aspect", round(float(aspect), 4), round(entry["aspect"], 4))
        check(file, "views", len(entry["views"]), entry["columns"] * entry["rows"])
        if entry.get("native"):
            Image.open(folder / entry["native"]).load()
            count("Pillow")


def transparencies(folder):
    if not shutil.which("pdftoppm"):
        return print("skipped: no pdftoppm")
    manifest = json.loads((folder / "transparencies.json").read_text())
    with tempfile.TemporaryDirectory() as pages:
        subprocess.run(["pdftoppm", "-r", "25.4", "-png", folder / "transparencies.pdf", f"{pages}/page"], check=True)
        files = sorted(Path(pages).iterdir())
        # the PDF has an assembly sheet and a chart in front of the layers
        check(folder, "pages", len(files), 2 + len(manifest["files"]))
        for file in files:
            size = Image.open(file).size
            near = all(abs(found - mm) <= 1.0 for found, mm in zip(size, manifest["page_mm"]))
            check(file, f"page of {manifest['page_mm']} mm is {size} pixels of 1 mm", near, True)
            count("pdftoppm")


def web_simulator(folder):
    preview = json.loads((folder / "stack/preview.json").read_text())
    inline = (folder / "preview.html").read_text()
    bundle = json.loads(re.search(r"LUMISTACK_INLINE\s*=\s*(\{.*?\})\s*;?\s*</script>", inline, re.S).group(1))
    check(folder, "first file", [preview["files"][0][key] for key in ("kind", "frame")], ["layer", 0])
    for file in preview["files"]:
        path = folder / file["path"]
        check(path, "bytes", path.stat().st_size, file["bytes"])
        png(path, (file["cols"], file["rows"]), 8)
        check(path, "copy in preview.html", base64.b64decode(bundle[file["path"]]) == path.read_bytes(), True)
    check(folder, "module in preview.html", base64.b64decode(bundle["wasm"])[:4], b"\0asm")


def image_magick(folder):
    """Checks all PNG files of the folder with ImageMagick, an independent reader besides Pillow."""
    if not shutil.which("identify"):
        return print("skipped: no ImageMagick")
    for file in folder.rglob("*.png"):
        found = subprocess.run(["identify", "-format", "%w %h\n", f"{file}[0]"], check=True, capture_output=True, text=True)
        check(file, "size", tuple(map(int, found.stdout.split()[:2])), Image.open(file).size)
        count("ImageMagick")


readers = {"images": images, "quilt": quilt, "transparencies": transparencies, "web_simulator": web_simulator}
for folder in sorted(run.glob("outputs/*/*")):
    readers[folder.name](folder)
image_magick(run / "outputs")
print(", ".join(f"{reader} {n}" for reader, n in sorted(opened.items())))
