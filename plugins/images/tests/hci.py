"""Prints as JSON the content of a folder in the format of the HCI 4D light field benchmark.

This reader follows only the format's description, and uses only Python's standard library. The file
parameters.cfg has the sections intrinsics, extrinsics and meta; every key below is required. The
file gt_disp_lowres.pfm is a portable float map for the central view. It contains the disparity
between neighbouring cameras in pixels, which is above 0 in front of the plane of focus.
"""

import configparser
import json
import math
import struct
import sys
from pathlib import Path

KEYS = {
    "intrinsics": {"image_resolution_x_px": int, "image_resolution_y_px": int, "focal_length_mm": float, "sensor_size_mm": float, "fstop": float},
    "extrinsics": {
        "num_cams_x": int,
        "num_cams_y": int,
        "baseline_mm": float,
        "focus_distance_m": float,
        "center_cam_x_m": float,
        "center_cam_y_m": float,
        "center_cam_z_m": float,
        "center_cam_rx_rad": float,
        "center_cam_ry_rad": float,
        "center_cam_rz_rad": float,
        "offset": float,
    },
    "meta": {
        "disp_min": float,
        "disp_max": float,
        "frustum_disp_min": float,
        "frustum_disp_max": float,
        "depth_map_scale": float,
        "scene": str,
        "category": str,
        "date": str,
        "version": str,
        "authors": lambda text: text.split(", "),
        "contact": str,
    },
}


def read_pfm(path):
    with open(path, "rb") as file:
        assert file.readline().rstrip() == b"Pf", "one channel"
        cols, rows = map(int, file.readline().split())
        scale = float(file.readline())
        order = "<" if scale < 0 else ">"
        values = struct.unpack(f"{order}{rows * cols}f", file.read())
    # the file contains the lowest row first
    return [[values[row * cols + col] for col in range(cols)] for row in reversed(range(rows))]


folder = Path(sys.argv[1])
text = (folder / "parameters.cfg").read_text()
parser = configparser.ConfigParser()
parser.read_string(text)
parameters = {key: kind(parser.get(section, key)) for section, keys in KEYS.items() for key, kind in keys.items()}
parameters["width"], parameters["height"] = parameters["image_resolution_x_px"], parameters["image_resolution_y_px"]
for camera in range(parameters["num_cams_x"] * parameters["num_cams_y"]):
    assert (folder / f"input_Cam{camera:03d}.png").is_file(), camera
disparities = read_pfm(folder / "gt_disp_lowres.pfm")
assert len(disparities) == parameters["height"] and len(disparities[0]) == parameters["width"]
notes = [line for line in text.splitlines() if line.startswith("#")]
shown = [[value if math.isfinite(value) else None for value in row] for row in disparities]
json.dump({"parameters": parameters, "disparities": shown, "notes": notes}, sys.stdout)
