"""Definitions of MaterialX's surface shaders, for an OpenUSD whose MaterialX library lacks them.

From a .mtlx file OpenUSD drops each shader that its MaterialX library does not define. The library
of the wheel usd-exchange defines only OpenPBR. This module adds the inputs (names, types, defaults) of the
other surface shaders. It also adds the nodes of UsdPreviewSurface that `materials` reads. """

import contextlib
import os
import shutil
import tempfile

from pxr import Plug, Sdf

SEARCHED = "PXR_MTLX_PLUGIN_SEARCH_PATHS"
# Every line is a type, a colon, and the inputs of this type as `name=default`; an input without a
# default ends with `=`. A single number is the default of all components of a colour or vector. A
# line that begins with `->` lists outputs.
SHADERS = {
    ("ND_standard_surface_surfaceshader", "standard_surface"): """
        float: base=1 diffuse_roughness=0 metalness=0 specular=1 specular_roughness=0.2 specular_IOR=1.5 specular_anisotropy=0 specular_rotation=0
        float: transmission=0 transmission_depth=0 transmission_scatter_anisotropy=0 transmission_dispersion=0 transmission_extra_roughness=0
        float: subsurface=0 subsurface_scale=1 subsurface_anisotropy=0 sheen=0 sheen_roughness=0.3 coat=0 coat_roughness=0.1 coat_anisotropy=0
        float: coat_rotation=0 coat_IOR=1.5 coat_affect_color=0 coat_affect_roughness=0 thin_film_thickness=0 thin_film_IOR=1.5 emission=0
        color3: base_color=0.8 specular_color=1 transmission_color=1 transmission_scatter=0 subsurface_color=1 subsurface_radius=1 sheen_color=1
        color3: coat_color=1 emission_color=1 opacity=1
        boolean: thin_walled=false
        vector3: normal= coat_normal= tangent=
    """,
    ("ND_UsdPreviewSurface_surfaceshader", "UsdPreviewSurface"): """
        color3: diffuseColor=0.18 emissiveColor=0 specularColor=0
        integer: useSpecularWorkflow=0 opacityMode=0
        float: metallic=0 roughness=0.5 clearcoat=0 clearcoatRoughness=0.01 opacity=1 opacityThreshold=0 ior=1.5 displacement=0 occlusion=1
        vector3: normal=
    """,
    ("ND_gltf_pbr_surfaceshader", "gltf_pbr"): """
        color3: base_color=1 specular_color=1 attenuation_color=1 sheen_color=0 emissive=0
        float: metallic=1 roughness=1 occlusion=1 transmission=0 specular=1 ior=1.5 alpha=1 alpha_cutoff=0.5 iridescence=0 iridescence_ior=1.3
        float: iridescence_thickness=100 sheen_roughness=0 clearcoat=0 clearcoat_roughness=0 emissive_strength=1 thickness=0 attenuation_distance=
        float: anisotropy_strength=0 anisotropy_rotation=0 dispersion=0
        integer: alpha_mode=0
        vector3: normal= tangent= clearcoat_normal=
    """,
    ("ND_surface_unlit", "surface_unlit"): """
        float: emission=1 transmission=0 opacity=1
        color3: emission_color=1 transmission_color=1
    """,
    ("ND_UsdPrimvarReader_vector2", "UsdPrimvarReader"): "string: varname=\nvector2: fallback=0\n-> vector2: out",
    ("ND_UsdTransform2d", "UsdTransform2d"): "vector2: in=0 scale=1 translation=0\nfloat: rotation=0\n-> vector2: out",
    ("ND_UsdUVTexture_23", "UsdUVTexture"): """
        filename: file=
        vector2: st=0
        string: wrapS=periodic wrapT=periodic
        vector4: fallback=0 scale=1 bias=0
        -> float: r g b a
        -> color3: rgb
    """,
}
COMPONENTS = {"color3": 3, "vector2": 2, "vector3": 3, "vector4": 4}


def document():
    """Returns the definitions as the text of a MaterialX file."""
    lines = ['<?xml version="1.0"?>', '<materialx version="1.39">']
    for (name, node), text in SHADERS.items():
        lines.append('<nodedef name="%s" node="%s">' % (name, node))
        surface = True
        for line in text.split("\n"):
            kind, _, entries = line.strip().partition(": ")
            for entry in entries.split():
                if kind.startswith("->"):
                    surface = False
                    lines.append('<output name="%s" type="%s"/>' % (entry, kind[3:]))
                    continue
                given, _, default = entry.partition("=")
                value = ' value="%s"' % ", ".join([default] * COMPONENTS.get(kind, 1)) if default else ""
                lines.append('<input name="%s" type="%s"%s/>' % (given, kind, value))
        if surface:
            lines.append('<output name="out" type="surfaceshader"/>')
        lines.append("</nodedef>")
    return "\n".join(lines + ["</materialx>"])


@contextlib.contextmanager
def definitions():
    """Makes the definitions known to OpenUSD, which reads them at its first use of MaterialX."""
    if not Sdf.FileFormat.FindByExtension("mtlx") or complete():
        yield
        return
    folder, before = tempfile.mkdtemp(prefix="lumistack-"), os.environ.get(SEARCHED)
    try:
        with open(os.path.join(folder, "surface_shaders.mtlx"), "w") as file:
            file.write(document())
        os.environ[SEARCHED] = os.pathsep.join([folder] + ([before] if before else []))
        yield
    finally:
        if before is None:
            os.environ.pop(SEARCHED, None)
        else:
            os.environ[SEARCHED] = before
        shutil.rmtree(folder, ignore_errors=True)


def complete():
    """Returns true if OpenUSD has a library with the shaders, or the environment names one."""
    plugin = Plug.Registry().GetPluginWithName("usdMtlx")
    library = os.path.join(plugin.resourcePath, "libraries", "bxdf", "standard_surface.mtlx") if plugin else ""
    return os.path.exists(library) or bool(os.environ.get("PXR_MTLX_STDLIB_SEARCH_PATHS"))
