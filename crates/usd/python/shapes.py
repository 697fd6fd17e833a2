"""Shapes other than meshes: implicit shapes, curves and points."""

from pxr import UsdGeom

from lumistack_usd import geometry

AXIS = {"X": "x", "Y": "y", "Z": "z"}
# For each type of implicit shape, the attributes that define its size.
SOLIDS = {
    "Sphere": ("radius",),
    "Cube": ("size",),
    "Cylinder": ("radius", "height"),
    "Cylinder_1": ("radiusTop", "radiusBottom", "height"),
    "Cone": ("radius", "height"),
    "Capsule": ("radius", "height"),
    "Capsule_1": ("radiusTop", "radiusBottom", "height"),
    "Plane": ("width", "length"),
}


def is_shape(prim, writer):
    """Returns true if `shape` can read the prim; a shape of an unknown type causes a warning."""
    name = str(prim.GetTypeName())
    if name in SOLIDS or prim.IsA(UsdGeom.BasisCurves) or prim.IsA(UsdGeom.Points):
        return True
    if prim.IsA(UsdGeom.Gprim) and not prim.IsA(UsdGeom.Mesh):
        writer.warn(prim.GetPath(), "shapes of type %s are not supported and are left out" % name)
    return False


def shape(prim, writer, time):
    """Returns the entry of a shape."""
    entry = {"place": str(prim.GetPath()), "primvars": geometry.primvars(prim, writer, time), "subsets": []}
    name = str(prim.GetTypeName())
    if name in SOLIDS:
        entry.update(kind="solid", solid=name.split("_")[0].lower(), sizes=[float(value(prim, size, time)) for size in SOLIDS[name]])
        entry["axis"] = AXIS.get(str(value(prim, "axis", time)), "z")
        return entry
    entry["points"] = geometry.value(prim.GetAttribute("points"), time, writer)
    source = UsdGeom.BasisCurves(prim) if prim.IsA(UsdGeom.BasisCurves) else UsdGeom.Points(prim)
    entry["widths"] = geometry.value(source.GetWidthsAttr(), time, writer)
    entry["widths_interpolation"] = str(source.GetWidthsInterpolation())
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("widths")
    if primvar and primvar.HasAuthoredValue():
        entry["widths"] = writer.array(primvar.ComputeFlattened(time))
        entry["widths_interpolation"] = str(primvar.GetInterpolation())
    if prim.IsA(UsdGeom.Points):
        entry["kind"] = "points"
        return entry
    entry.update(kind="curves", counts=geometry.value(source.GetCurveVertexCountsAttr(), time, writer))
    for name in ("type", "basis", "wrap"):
        entry["curve_" + name] = str(value(prim, name, time))
    normals = geometry.value(prim.GetAttribute("normals"), time, writer)
    if normals is not None:
        entry["normals"], entry["normals_interpolation"] = normals, str(source.GetNormalsInterpolation())
    return entry


def value(prim, name, time):
    attribute = prim.GetAttribute(name)
    return attribute.Get(time) if attribute else None
