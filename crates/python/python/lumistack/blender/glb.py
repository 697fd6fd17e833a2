"""Adds to a .glb file the content that Blender's exporter leaves out: lights with a surface, the
environment, and cameras with their focus."""

from __future__ import annotations

import base64
import json
import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_UNSIGNED_INT, _FLOAT = 5125, 5126
LIGHTS, STRENGTH = "KHR_lights_punctual", "KHR_materials_emissive_strength"


class Glb:
    """A glTF document with one buffer."""

    def __init__(self, document: dict[str, Any], binary: bytes) -> None:
        self.document = document
        self.binary = bytearray(binary)

    @classmethod
    def empty(cls) -> Glb:
        return cls({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}, b"")

    @classmethod
    def read(cls, path: str | Path) -> Glb:
        data = Path(path).read_bytes()
        if len(data) < 20 or struct.unpack_from("<I", data)[0] != _MAGIC:
            raise ValueError(f"{path}: expected a .glb file, found a file of another kind")
        chunks: dict[int, bytes] = {}
        at = 12
        while at + 8 <= len(data):
            length, kind = struct.unpack_from("<II", data, at)
            chunks.setdefault(kind, data[at + 8 : at + 8 + length])
            at += 8 + length
        document = json.loads(chunks[_JSON])
        document.setdefault("scenes", [{}])
        document.setdefault("scene", 0)
        return cls(document, chunks.get(_BIN, b""))

    def write(self, path: str | Path) -> None:
        if self.binary:
            self.document.setdefault("buffers", [{}])[0]["byteLength"] = len(self.binary)
        text = json.dumps(self.document, ensure_ascii=False).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + b"\0" * (-len(self.binary) % 4)
        chunks = struct.pack("<II", len(text), _JSON) + text
        if binary:
            chunks += struct.pack("<II", len(binary), _BIN) + binary
        Path(path).write_bytes(struct.pack("<III", _MAGIC, 2, 12 + len(chunks)) + chunks)

    @property
    def scene(self) -> dict[str, Any]:
        scene: dict[str, Any] = self.document["scenes"][self.document["scene"]]
        return scene

    def drop_flat_triangles(self) -> int:
        """Removes the triangles without area, and returns their number. Blender's exporter writes
        such triangles for text and curves; the reader of the file would warn of them."""
        # Blender always has NumPy, but other programs that import this module may lack it.
        import numpy

        dropped = 0
        for mesh in self.document.get("meshes", []):
            for primitive in mesh["primitives"]:
                if primitive.get("mode", 4) != 4 or "indices" not in primitive or "POSITION" not in primitive["attributes"]:
                    continue
                accessor = self.document["accessors"][primitive["indices"]]
                positions = self._values(primitive["attributes"]["POSITION"])
                indices = self._values(primitive["indices"])
                if positions is None or indices is None:
                    continue
                # Divide by the largest coordinate of the edges, so that the area of a tiny triangle
                # does not become 0.
                corners = positions.astype(numpy.float64)[indices.reshape(-1, 3)]
                edges = corners[:, 1:] - corners[:, :1]
                edges /= numpy.maximum(numpy.abs(edges).max(axis=(1, 2), keepdims=True), 1e-300)
                has_area = numpy.linalg.norm(numpy.cross(edges[:, 0], edges[:, 1]), axis=1) > 1e-300
                # A primitive without triangles is invalid, so keep the triangles if all are flat.
                if has_area.all() or not has_area.any():
                    continue
                kept = indices.reshape(-1, 3)[has_area]
                primitive["indices"] = self._accessor(kept.tobytes(), accessor["componentType"], "SCALAR", kept.size, {})
                dropped += int((~has_area).sum())
        return dropped

    def _values(self, number: int) -> Any:
        """Returns the values of an accessor of positions or indices as an array; None if its values
        are not adjacent in the buffer of this file."""
        import numpy

        accessor = self.document["accessors"][number]
        kind = {5121: "u1", 5123: "<u2", _UNSIGNED_INT: "<u4", _FLOAT: "<f4"}.get(accessor["componentType"])
        width = {"SCALAR": 1, "VEC3": 3}.get(accessor["type"])
        if kind is None or width is None or "sparse" in accessor or "bufferView" not in accessor:
            return None
        view = self.document["bufferViews"][accessor["bufferView"]]
        stride = width * int(kind[-1])
        is_packed = view.get("byteStride", stride) == stride and "extensions" not in view
        if not is_packed or view["buffer"] != 0:
            return None
        begin = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        values = numpy.frombuffer(bytes(self.binary[begin : begin + accessor["count"] * stride]), numpy.dtype(kind))
        return values.reshape(-1, width) if width > 1 else values

    def add_node(self, name: str, matrix: Sequence[Sequence[float]] | None = None, **parts: Any) -> None:
        """Adds a node to the scene. `matrix` has four rows, in glTF's axes."""
        node: dict[str, Any] = {"name": name, **parts}
        if matrix is not None:
            node["matrix"] = [float(matrix[row][column]) for column in range(4) for row in range(4)]
        self.scene.setdefault("nodes", []).append(self._append("nodes", node))

    def add_light(self, name: str, matrix: Sequence[Sequence[float]], light: dict[str, Any]) -> None:
        self._use(LIGHTS)
        lights = self.document.setdefault("extensions", {}).setdefault(LIGHTS, {}).setdefault("lights", [])
        lights.append({"name": name, **light})
        self.add_node(name, matrix, extensions={LIGHTS: {"light": len(lights) - 1}})

    def add_glow(
        self,
        name: str,
        matrix: Sequence[Sequence[float]],
        positions: Sequence[Sequence[float]],
        triangles: Sequence[Sequence[int]],
        radiance: Sequence[float],
        seen: bool = True,
    ) -> None:
        """Adds a black surface that emits this radiance from its front; `seen` is true if the surface is
        visible to cameras."""
        # Add a black material with emission.
        strength = max(max(radiance), 1e-30)
        self._use(STRENGTH)
        material = self._append(
            "materials",
            {
                "name": name,
                "pbrMetallicRoughness": {"baseColorFactor": [0.0, 0.0, 0.0, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0},
                "emissiveFactor": [value / strength for value in radiance],
                "extensions": {STRENGTH: {"emissiveStrength": strength}, "KHR_materials_specular": {"specularFactor": 0.0}},
                "extras": {"lumistack": {"lamp": "seen" if seen else "unseen"}},
            },
        )
        self._use("KHR_materials_specular")
        # Add the mesh and its node.
        flat = [float(value) for position in positions for value in position]
        accessor = {
            "min": [min(flat[axis::3]) for axis in range(3)],
            "max": [max(flat[axis::3]) for axis in range(3)],
        }
        corners = [index for triangle in triangles for index in triangle]
        primitive = {
            "attributes": {"POSITION": self._accessor(struct.pack(f"<{len(flat)}f", *flat), _FLOAT, "VEC3", len(positions), accessor)},
            "indices": self._accessor(struct.pack(f"<{len(corners)}I", *corners), _UNSIGNED_INT, "SCALAR", len(corners), {}),
            "material": material,
        }
        mesh = self._append("meshes", {"name": name, "primitives": [primitive]})
        self.add_node(name, matrix, mesh=mesh)

    def add_camera(self, name: str, matrix: Sequence[Sequence[float]], camera: dict[str, Any], focus_distance: float | None) -> None:
        """Adds a camera. The order of these calls is the order of cameras in the file."""
        if focus_distance is not None:
            camera = {**camera, "extras": {"lumistack": {"focus_distance": focus_distance}}}
        self.add_node(name, matrix, camera=self._append("cameras", {"name": name, **camera}))

    def set_environment(self, width: int, height: int, texels: Sequence[Sequence[float]], strength: float = 1.0) -> None:
        """Sets the environment. `texels` are linear RGB, row by row from the top. The middle column of the
        picture looks along glTF's -z, and columns to the right turn towards +x."""
        uri = "data:image/vnd.radiance;base64," + base64.b64encode(radiance_hdr(width, height, texels)).decode()
        extras = self.scene.setdefault("extras", {})
        extras.setdefault("lumistack", {})["environment"] = {"image": uri, "strength": strength}

    def _append(self, kind: str, entry: dict[str, Any]) -> int:
        entries = self.document.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def _use(self, extension: str) -> None:
        used = self.document.setdefault("extensionsUsed", [])
        if extension not in used:
            used.append(extension)

    def _accessor(self, data: bytes, component: int, kind: str, count: int, more: dict[str, Any]) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        view = self._append("bufferViews", {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        self.binary += data
        if not self.document.get("buffers"):
            self.document["buffers"] = [{"byteLength": 0}]
        return self._append("accessors", {"bufferView": view, "componentType": component, "type": kind, "count": count, **more})


def radiance_hdr(width: int, height: int, texels: Sequence[Sequence[float]]) -> bytes:
    """Returns a Radiance picture with shared exponents, not compressed."""
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    return header + b"".join(map(_rgbe, texels))


def _rgbe(rgb: Sequence[float]) -> bytes:
    brightest = max(rgb)
    if not brightest > 1e-32:
        return b"\0\0\0\0"
    # brightest = mantissa 2^exponent. Rounding the mantissa to 8 bits may give 256, which does not
    # fit into a byte; then the exponent grows.
    mantissa, exponent = math.frexp(brightest)
    if mantissa >= 255.5 / 256:
        exponent += 1
    scale = 256.0 / 2.0**exponent
    return bytes([min(int(max(value, 0.0) * scale + 0.5), 255) for value in rgb] + [exponent + 128])
