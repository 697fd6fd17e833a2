"""Particle fields: Gaussian splats, as in UsdVol since OpenUSD 26.03.

An older OpenUSD does not know the types of particle fields. It reports the fields as prims without
a type, but their attributes can be read by name.
"""

from pxr import Usd

from lumistack_usd import geometry

ELLIPSOID, SURFLET = "ParticleFieldKernelGaussianEllipsoidAPI", "ParticleFieldKernelGaussianSurfletAPI"
SPLAT = "ParticleField3DGaussianSplat"
HARMONICS = "radiance:sphericalHarmonicsCoefficients"


def is_field(prim):
    """Returns true if the prim is a particle field with any kernel."""
    return str(prim.GetTypeName()) in ("ParticleField", SPLAT) or "ParticleField" in known_bases(prim)


def known_bases(prim):
    """Returns the base types of the prim's type; none if this OpenUSD does not know the type."""
    kind = prim.GetPrimTypeInfo().GetSchemaType()
    return [Usd.SchemaRegistry.GetSchemaTypeName(base) for base in kind.GetAllAncestorTypes()] if kind else []


def is_shown(prim, writer):
    """Returns true if a particle field is rendered: if it consists of splats, and its purpose is
    neither `proxy` nor `guide`. A field without a Gaussian kernel causes a warning."""
    purpose = prim.GetAttribute("purpose")
    if purpose and purpose.Get() in ("proxy", "guide"):
        # An older OpenUSD does not compute the purpose of unknown types, so read the prim's own
        # value.
        return False
    kernels = [kernel for kernel in schemas(prim) if "Kernel" in kernel and not kernel.endswith("BaseAPI")]
    if str(prim.GetTypeName()) == SPLAT or ELLIPSOID in kernels or SURFLET in kernels:
        return True
    found = ", ".join(kernels) or "no kernel"
    writer.warn(prim.GetPath(), "expected a particle field with a Gaussian kernel, found %s; the field is left out" % found)
    return False


def schemas(prim):
    """Returns the names of the applied schemas, also those that this OpenUSD does not know."""
    authored = prim.GetMetadata("apiSchemas")
    return list(prim.GetAppliedSchemas()) + (list(authored.GetAppliedItems()) if authored else [])


def field(prim, writer, time):
    """Returns the entry of a field of splats."""
    kernels = schemas(prim)
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree")
    degree = degree.Get(time) if degree else None
    return {
        "kind": "splats",
        "place": str(prim.GetPath()),
        "positions": values(prim, "positions", writer, time),
        "orientations": values(prim, "orientations", writer, time),
        "scales": values(prim, "scales", writer, time),
        "opacities": values(prim, "opacities", writer, time),
        "harmonics": values(prim, HARMONICS, writer, time),
        "degree": 3 if degree is None else int(degree),
        "flat": SURFLET in kernels and ELLIPSOID not in kernels,
        "colour_space": colour_space(prim),
        "subsets": [],
    }


def values(prim, name, writer, time):
    """Returns the array of the attribute `name`. If it has no values, returns the array of the
    half-precision attribute, whose name ends with h."""
    for name in (name, name + "h"):
        found = geometry.value(prim.GetAttribute(name), time, writer)
        if found is not None and found["shape"][0]:
            return found
    return None


def colour_space(prim):
    """Returns the name of the colour space of the harmonics. If they declare none, returns the
    colour space of the prim or of its nearest ancestor that declares one."""
    for name in (HARMONICS, HARMONICS + "h"):
        attribute = prim.GetAttribute(name)
        if attribute and attribute.GetColorSpace():
            return str(attribute.GetColorSpace())
    while prim and not prim.IsPseudoRoot():
        attribute = prim.GetAttribute("colorSpace:name")
        if attribute and attribute.Get():
            return str(attribute.Get())
        prim = prim.GetParent()
    return ""
