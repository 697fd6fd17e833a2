"""Collects a scene package: a JSON header, and the arrays to which it refers.

A file consists of the magic `LUMIPKG1`, the header's length as a little-endian u64, the header, and
the arrays. Each array starts at a multiple of 64 bytes from the start of the file. The header
refers to an array as `{"buffer": k, "type": "f32", "shape": [n, 3]}`. `buffers` lists the offset
and the length of each array. Offsets are relative to the first multiple of 64 after the header.
"""

import json
import math
import os

from pxr import Ar

ALIGNMENT = 64
# type codes of the buffer protocol, for native size and byte order
TYPES = {"f": "f32", "d": "f64", "e": "f16", "i": "i32", "I": "u32", "b": "i8", "B": "u8", "h": "i16", "H": "u16", "?": "u8"}


def finite(value):
    """Replaces NaN and infinity, which JSON lacks, with null. The reader refuses null where it
    expects a number."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class Refused(Exception):
    """The error that the scene cannot be read; the message states the reason."""


class Writer:
    def __init__(self):
        self.header = {"schema": "lumistack.scene-package", "version": 1}
        self.buffers = []
        self.warnings = []
        self._warned = set()
        self._files = {}
        self.geometries = []
        self.instances = []
        self.materials = []
        self.images = []
        self.lights = []
        self.cameras = []
        self._images = {}

    def array(self, values):
        """Adds an array (buffer protocol) without copying it, and returns a reference to it."""
        view = memoryview(values)
        code = view.format
        if code in ("l", "L", "q", "Q"):
            kind = ("i" if code in "lq" else "u") + str(8 * view.itemsize)
        else:
            kind = TYPES[code]
        self.buffers.append(view)
        return {"buffer": len(self.buffers) - 1, "type": kind, "shape": list(view.shape)}

    def warn(self, place, message):
        """Adds a warning for the user, unless the same warning was added before."""
        entry = (str(place), message)
        if entry not in self._warned:
            self._warned.add(entry)
            self.warnings.append({"place": entry[0], "message": entry[1]})

    def file(self, path):
        """Records that the scene depends on a file on disk: the file at `path`, or the package that
        contains it."""
        path = Ar.SplitPackageRelativePathOuter(path)[0]
        if path and os.path.isfile(path):
            self._files[os.path.abspath(path)] = True

    def image(self, key, make):
        """Returns the index of the image with this key. `make` creates the image's entry if the key
        is new."""
        if key not in self._images:
            self.images.append(make())
            self._images[key] = len(self.images) - 1
        return self._images[key]

    def finished_header(self):
        """Returns the header, complete except for the offsets of its buffers."""
        lists = ("warnings", "geometries", "instances", "materials", "images", "lights", "cameras")
        return dict(self.header, files=list(self._files), **{name: getattr(self, name) for name in lists})

    def header_text(self, **places):
        """Returns the header as JSON in UTF-8. `places` has the offsets of the buffers, for a file."""
        header = dict(self.finished_header(), **places)
        try:
            return json.dumps(header, allow_nan=False).encode("utf-8")
        except ValueError:
            return json.dumps(finite(header)).encode("utf-8")

    def write(self, file):
        """Writes the package."""
        places, end = [], 0
        for view in self.buffers:
            places.append([end, view.nbytes])
            end += -(-view.nbytes // ALIGNMENT) * ALIGNMENT
        header = self.header_text(buffers=places)
        file.write(b"LUMIPKG1" + len(header).to_bytes(8, "little") + header)
        file.write(bytes(-(16 + len(header)) % ALIGNMENT))
        for view in self.buffers:
            if view.nbytes:
                file.write(view if view.c_contiguous else view.tobytes())
                file.write(bytes(-view.nbytes % ALIGNMENT))
