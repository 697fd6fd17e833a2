"""Writes a glTF scene of the generator as USD.

`python to_usd.py still-life.gltf` makes still-life.usda in the same folder, with its meshes in still-life.usdc. It also makes still-life.usdz, which contains both files and the pictures.

Needs usd-core. Both formats must render to the same picture, so every value is kept, in the conventions of USD. Only the features of glTF that `still-life` uses are converted.
"""

import json
import math
import os
import struct
import sys

from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdShade, UsdUtils, Vt

COMPONENTS = {5121: "B", 5123: "H", 5125: "I", 5126: "f"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def main(path):
    stem, folder = os.path.splitext(os.path.basename(path))[0], os.path.dirname(os.path.abspath(path))
    os.chdir(folder)
    with open(stem + ".gltf", encoding="utf-8") as file:
        document = json.load(file)
    with open(document["buffers"][0]["uri"], "rb") as file:
        data = file.read()
    shapes = Usd.Stage.CreateNew(stem + ".usdc")
    for mesh in document["meshes"]:
        path = "/" + identifier(mesh["name"])
        UsdGeom.Xform.Define(shapes, path)
        for number, primitive in enumerate(mesh["primitives"]):
            write_mesh(shapes, "%s/part_%d" % (path, number), primitive, lambda index: accessor(document, data, index))
    shapes.GetRootLayer().Save()
    stage = Usd.Stage.CreateNew(stem + ".usda")
    root = "/" + identifier(stem)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, root).GetPrim())
    stage.GetRootLayer().comment = "Written by scenes/generator/to_usd.py from the glTF scene of this name."
    materials = [write_material(stage, root, document, entry) for entry in document["materials"]]
    for node in document["nodes"]:
        write_node(stage, root, stem, document, node, materials)
    environment = document["scenes"][0].get("extras", {}).get("lumistack", {}).get("environment")
    if environment:
        dome = UsdLux.DomeLight.Define(stage, root + "/sky")
        dome.CreateTextureFileAttr("./" + environment["image"])
        dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
        # the centre of an environment map looks along +z in USD, and along -z in this project
        dome.AddRotateYOp().Set(180.0)
        dome.CreateIntensityAttr(float(environment.get("strength", 1.0)))
    stage.GetRootLayer().Save()
    if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(stem + ".usda"), stem + ".usdz"):
        sys.exit("cannot write " + stem + ".usdz")


def identifier(name):
    name = name.replace(" +", " plus ").replace(" -", " minus ").replace(" \u2212", " minus ")
    return Tf.MakeValidIdentifier(name)


def accessor(document, data, index):
    """Returns the rows of an accessor, each a tuple of numbers."""
    entry = document["accessors"][index]
    view = document["bufferViews"][entry["bufferView"]]
    width, code = WIDTHS[entry["type"]], COMPONENTS[entry["componentType"]]
    start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
    size = width * struct.calcsize(code)
    stride = view.get("byteStride", size)
    rows = [struct.unpack_from("<%d%s" % (width, code), data, start + i * stride) for i in range(entry["count"])]
    return [row[0] for row in rows] if width == 1 else rows


def write_mesh(stage, path, primitive, read):
    mesh = UsdGeom.Mesh.Define(stage, path)
    points, indices = read(primitive["attributes"]["POSITION"]), read(primitive["indices"])
    mesh.CreatePointsAttr(Vt.Vec3fArray(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * (len(indices) // 3)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray(indices))
    mesh.CreateNormalsAttr(Vt.Vec3fArray(read(primitive["attributes"]["NORMAL"])))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    if "TEXCOORD_0" in primitive["attributes"]:
        # v increases downwards in glTF, and upwards in USD
        st = [(u, 1.0 - v) for u, v in read(primitive["attributes"]["TEXCOORD_0"])]
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        primvar.Set(Vt.Vec2fArray(st))


def write_material(stage, root, document, entry):
    path = "%s/materials/%s" % (root, identifier(entry["name"]))
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, path + "/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    source = entry["pbrMetallicRoughness"]
    kinds = Sdf.ValueTypeNames
    color = source.get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
    if "baseColorTexture" in source:
        output = texture(stage, path, document, source["baseColorTexture"], "base_color", "sRGB")
        surface.CreateInput("diffuseColor", kinds.Color3f).ConnectToSource(output("rgb", kinds.Color3f))
    else:
        surface.CreateInput("diffuseColor", kinds.Color3f).Set(Gf.Vec3f(*color[:3]))
    if "metallicRoughnessTexture" in source:
        output = texture(stage, path, document, source["metallicRoughnessTexture"], "metallic_roughness", "raw")
        surface.CreateInput("roughness", kinds.Float).ConnectToSource(output("g", kinds.Float))
        surface.CreateInput("metallic", kinds.Float).ConnectToSource(output("b", kinds.Float))
    else:
        surface.CreateInput("roughness", kinds.Float).Set(source.get("roughnessFactor", 1.0))
        surface.CreateInput("metallic", kinds.Float).Set(source.get("metallicFactor", 1.0))
    strength = entry.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    if "emissiveFactor" in entry:
        surface.CreateInput("emissiveColor", kinds.Color3f).Set(Gf.Vec3f(*entry["emissiveFactor"]) * strength)
    return material, entry.get("doubleSided", False)


def texture(stage, path, document, use, name, color_space):
    """Adds a texture that is read at the texture coordinates `st`. Returns a function that creates outputs of the texture's node."""
    reader = UsdShade.Shader.Define(stage, path + "/st")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    entry = document["textures"][use["index"]]
    sampler = document["samplers"][entry["sampler"]]
    shader = UsdShade.Shader.Define(stage, "%s/%s" % (path, name))
    shader.CreateIdAttr("UsdUVTexture")
    shader.CreateInput("file", Sdf.ValueTypeNames.Asset).Set("./" + document["images"][entry["source"]]["uri"])
    shader.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set(color_space)
    shader.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    wraps = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
    for axis in "ST":
        shader.CreateInput("wrap" + axis, Sdf.ValueTypeNames.Token).Set(wraps[sampler.get("wrap" + axis, 10497)])
    return lambda channels, kind: shader.CreateOutput(channels, kind)


def write_node(stage, root, stem, document, node, materials):
    path = "%s/%s" % (root, identifier(node["name"]))
    if "camera" in node:
        prim = write_camera(stage, path, document["cameras"][node["camera"]])
    else:
        mesh = document["meshes"][node["mesh"]]
        prim = UsdGeom.Xform.Define(stage, path)
        prim.GetPrim().GetReferences().AddReference("./%s.usdc" % stem, "/" + identifier(mesh["name"]))
        for number, primitive in enumerate(mesh["primitives"]):
            material, double_sided = materials[primitive["material"]]
            part = UsdGeom.Mesh(stage.GetPrimAtPath("%s/part_%d" % (path, number)))
            part.CreateDoubleSidedAttr(double_sided)
            UsdShade.MaterialBindingAPI.Apply(part.GetPrim()).Bind(material)
    if "translation" in node:
        prim.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*node["translation"]))
    if "rotation" in node:
        x, y, z, w = node["rotation"]
        prim.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(w, x, y, z))
    if "scale" in node:
        prim.AddScaleOp().Set(Gf.Vec3f(*node["scale"]))


def write_camera(stage, path, entry):
    camera = UsdGeom.Camera.Define(stage, path)
    perspective = entry["perspective"]
    height = 24.0
    camera.CreateVerticalApertureAttr(height)
    camera.CreateHorizontalApertureAttr(height * perspective["aspectRatio"])
    camera.CreateFocalLengthAttr(0.5 * height / math.tan(0.5 * perspective["yfov"]))
    camera.CreateClippingRangeAttr(Gf.Vec2f(perspective["znear"], perspective["zfar"]))
    focus_distance = entry.get("extras", {}).get("lumistack", {}).get("focus_distance")
    if focus_distance:
        camera.CreateFocusDistanceAttr(focus_distance)
    return camera


if __name__ == "__main__":
    main(sys.argv[1])
