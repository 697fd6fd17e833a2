"""Prints bounds and mean of the corners of Khronos' Fox at a few times, for animations.rs. The
script follows the specification of glTF 2.0, and uses only NumPy.

Usage: python3 fox.py .../Fox/Fox.glb
"""
import json, struct, sys
import numpy as np

data = open(sys.argv[1], "rb").read()
size = struct.unpack_from("<I", data, 12)[0]
gltf, binary = json.loads(data[20 : 20 + size]), data[28 + size :]


def read(index):
    a = gltf["accessors"][index]
    view = gltf["bufferViews"][a["bufferView"]]
    kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[a["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[a["type"]]
    start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
    stride = view.get("byteStride", 0) or width * np.dtype(kind).itemsize
    rows = [np.frombuffer(binary, kind, width, start + i * stride) for i in range(a["count"])]
    return np.array(rows, float)


def matrix(t, q, s):
    x, y, z, w = q
    m = np.eye(4)
    m[:3, :3] = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]) * np.array(s)
    m[:3, 3] = t
    return m


def pose(name, t):
    local = [dict(n) for n in gltf["nodes"]]
    animation = next(a for a in gltf["animations"] if a["name"] == name)
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        keys, values = read(sampler["input"])[:, 0], read(sampler["output"])
        assert sampler.get("interpolation", "LINEAR") == "LINEAR"
        path = channel["target"]["path"]
        if path == "rotation":
            k = int(np.clip(np.searchsorted(keys, t, "right") - 1, 0, len(keys) - 2))
            u = np.clip((t - keys[k]) / (keys[k + 1] - keys[k]), 0, 1)
            a, b = values[k] / np.linalg.norm(values[k]), values[k + 1] / np.linalg.norm(values[k + 1])
            if a @ b < 0:
                b = -b
            angle = np.arccos(min(a @ b, 1))
            value = a if angle < 1e-6 else (np.sin((1 - u) * angle) * a + np.sin(u * angle) * b) / np.sin(angle)
        else:
            value = np.array([np.interp(t, keys, column) for column in values.T])
        local[channel["target"]["node"]][path] = value
    world = [None] * len(local)

    def place(i, parent):
        n = local[i]
        world[i] = parent @ matrix(n.get("translation", [0, 0, 0]), n.get("rotation", [0, 0, 0, 1]), n.get("scale", [1, 1, 1]))
        for child in n.get("children", []):
            place(child, world[i])

    for root in gltf["scenes"][gltf.get("scene", 0)]["nodes"]:
        place(root, np.eye(4))
    return world


for name, t in [("Survey", 0.0), ("Survey", 1.7), ("Walk", 0.3), ("Run", 99.0)]:
    world = pose(name, t)
    skin = gltf["skins"][0]
    inverse = read(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    joints = np.array([world[j] @ inverse[i] for i, j in enumerate(skin["joints"])])
    attributes = gltf["meshes"][0]["primitives"][0]["attributes"]
    points = np.c_[read(attributes["POSITION"]), np.ones(gltf["accessors"][attributes["POSITION"]]["count"])]
    index, weight = read(attributes["JOINTS_0"]).astype(int), read(attributes["WEIGHTS_0"])
    weight = weight / weight.sum(1, keepdims=True)
    moved = np.einsum("vj,vjab,vb->va", weight, joints[index], points)[:, :3]
    row = lambda v: "[" + ", ".join(f"{x:.4f}" for x in v) + "]"
    print(f'    ("{name}", {t}, [{row(moved.min(0))}, {row(moved.max(0))}, {row(moved.mean(0))}]),')
