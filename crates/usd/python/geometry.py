"""Makes the scene package's entries of meshes at one time code. An entry refers to arrays in the
package."""

from pxr import UsdGeom, Vt

# Types of texture coordinates, and names of primvars with colours. Surfaces use these primvars.
TEXTURE_COORDINATES = ("texCoord2f[]", "texCoord2d[]", "texCoord2h[]", "float2[]", "double2[]", "half2[]")
COLOURS = ("displayColor", "displayOpacity")
# For each type of a primvar with a single value, the type of an array of such values.
SINGLE = {"color3f": Vt.Vec3fArray, "color3d": Vt.Vec3dArray, "color3h": Vt.Vec3hArray, "float": Vt.FloatArray}


def value(attribute, time, writer):
    """Returns a reference to the array of an attribute. None if the attribute has no value, or, after
    a warning, if the value is not an array."""
    array = attribute.Get(time) if attribute else None
    if array is None:
        return None
    try:
        return writer.array(array)
    except TypeError:
        writer.warn(attribute.GetPath(), "expected %s, found %s; the attribute is left out" % (attribute.GetTypeName(), type(array).__name__))
        return None


def mesh(prim, writer, time, pose=None):
    """Returns the entry of a `UsdGeomMesh`. If `pose` is given, its points and normals replace the
    points and normals of the file."""
    points, normals = pose or (None, None)
    source = UsdGeom.Mesh(prim)
    entry = {
        "kind": "mesh",
        "place": str(prim.GetPath()),
        "points": writer.array(points) if points is not None else value(source.GetPointsAttr(), time, writer),
        "counts": value(source.GetFaceVertexCountsAttr(), time, writer),
        "indices": value(source.GetFaceVertexIndicesAttr(), time, writer),
        "left_handed": source.GetOrientationAttr().Get(time) == "leftHanded",
        "one_sided": one_sided(source, time),
        "holes": value(source.GetHoleIndicesAttr(), time, writer),
        "primvars": primvars(prim, writer, time),
        "subsets": [],
    }
    scheme = source.GetSubdivisionSchemeAttr().Get(time)
    # Write the subdivision rules, by which `src/refine.rs` refines the mesh.
    if scheme != "none":
        entry["subdivision"] = {
            "scheme": str(scheme),
            "interpolate_boundary": str(source.GetInterpolateBoundaryAttr().Get(time)),
            "face_varying": str(source.GetFaceVaryingLinearInterpolationAttr().Get(time)),
            "triangle_rule": str(source.GetTriangleSubdivisionRuleAttr().Get(time)),
            "crease_indices": value(source.GetCreaseIndicesAttr(), time, writer),
            "crease_lengths": value(source.GetCreaseLengthsAttr(), time, writer),
            "crease_sharpnesses": value(source.GetCreaseSharpnessesAttr(), time, writer),
            "corner_indices": value(source.GetCornerIndicesAttr(), time, writer),
            "corner_sharpnesses": value(source.GetCornerSharpnessesAttr(), time, writer),
        }
    if pose:
        # The file's normals belong to the rest pose, so remove them. `normals` are the normals of
        # the pose.
        entry["primvars"] = [primvar for primvar in entry["primvars"] if primvar["name"] != "normals"]
        if normals:
            entry["primvars"].append({"name": "normals", "interpolation": normals[0], "values": writer.array(normals[1])})
    elif not any(primvar["name"] == "normals" for primvar in entry["primvars"]):
        array = value(source.GetNormalsAttr(), time, writer)
        if array is not None:
            interpolation = str(source.GetNormalsInterpolation())
            entry["primvars"].append({"name": "normals", "interpolation": interpolation, "values": array})
    return entry


def one_sided(gprim, time):
    """Returns true if the file declares that only the front is visible. Without a declaration both
    sides are visible, as in USD's renderers."""
    attribute = gprim.GetDoubleSidedAttr()
    return attribute.HasAuthoredValue() and not attribute.Get(time)


def primvars(prim, writer, time):
    """Returns the primvars that affect the shading of surfaces, including inherited ones."""
    found = []
    for primvar in UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance():
        name, kind = str(primvar.GetPrimvarName()), str(primvar.GetTypeName())
        if name not in COLOURS and name != "normals" and kind not in TEXTURE_COORDINATES:
            continue
        values = primvar.Get(time)
        if values is None:
            continue
        if kind in SINGLE:
            values = SINGLE[kind]([values])
        try:
            entry = {"name": name, "interpolation": str(primvar.GetInterpolation()), "values": writer.array(values)}
            if primvar.IsIndexed():
                indices = primvar.GetIndices(time)
                if indices is not None:
                    entry["indices"] = writer.array(indices)
        except (KeyError, TypeError):
            writer.warn(prim.GetPath(), "the primvar %s is left out, since its type %s is not supported" % (name, kind))
            continue
        found.append(entry)
    return found
