"""Materials: their surface shaders, with inputs reduced to constants, textures and primvars.

An input is `{"value": [..]}`, `{"text": text}`, `{"primvar": name}` or `{"texture": t}`. Component k of a texture is
scale[k] · texel[channels[k]] + bias[k]. The texture coordinates are the primvar `primvar` after
`transform`: u' = t0 u + t2 v + t4, v' = t1 u + t3 v + t5, where v points up. Operations
whose results have none of these forms cause a warning. Inputs that depend on such an operation keep
their defaults.
"""

import math
import zipfile

from pxr import Ar, Gf, Sdf, UsdShade


MODELS = {
    "UsdPreviewSurface": "UsdPreviewSurface",
    "ND_UsdPreviewSurface_surfaceshader": "UsdPreviewSurface",
    "ND_standard_surface_surfaceshader": "standard_surface",
    "ND_open_pbr_surface_surfaceshader": "open_pbr_surface",
    "ND_gltf_pbr_surfaceshader": "gltf_pbr",
    "ND_surface_unlit": "surface_unlit",
}
# The value of inputs that depend on an unknown node.
UNKNOWN = {"unknown": True}
IDENTITY = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]
OPERATIONS = (
    "add subtract multiply divide mix invert extract swizzle separate2 separate3 separate4 combine2 combine3 combine4"
    " normalize transformnormal transformvector clamp remap range"
).split()
FRAME = ("normal", "tangent", "bitangent")
SIZES = {"float": 1, "integer": 1, "boolean": 1, "vector2": 2, "color3": 3, "vector3": 3, "color4": 4, "vector4": 4}
OUTPUT_CHANNELS = {"r": [0], "g": [1], "b": [2], "a": [3], "rgb": [0, 1, 2], "rgba": [0, 1, 2, 3]}
# Components of the inputs of nodes that combine more than single numbers.
WIDTHS = {"color4CF": [3, 1], "vector4VF": [3, 1], "vector4VV": [2, 2]}
ADDRESS_MODES = {"constant": "black", "clamp": "clamp", "periodic": "repeat", "mirror": "mirror"}
SRGB = ("srgb_texture", "sRGB", "srgb_rec709_scene", "srgb_rec709_display", "g22_rec709")
# Converts the primaries of ACES AP1 to linear Rec. 709, with Bradford adaptation of white to D65.
ACESCG = ((1.70505, -0.62179, -0.08326), (-0.13026, 1.14080, -0.01055), (-0.02400, -0.12897, 1.15297))


def material(prim, writer, time):
    """Returns the entry of a material: place, name, `model` (None if the shader is unknown) and
    `inputs`.
    """
    entry = {"place": str(prim.GetPath()), "name": prim.GetName(), "model": None, "inputs": {}}
    source = UsdShade.Material(prim)
    unknown = []
    # Take the first surface shader that is known; MaterialX shaders precede universal ones.
    for context in ("mtlx", ""):
        shader = source.ComputeSurfaceSource(context)[0]
        if not shader:
            continue
        kind = str(shader.GetIdAttr().Get() or "")
        if kind in MODELS:
            graph = Graph(writer, time, MODELS[kind])
            entry["model"] = MODELS[kind]
            for given in shader.GetInputs():
                found = graph.input(given)
                if found is not None and found is not UNKNOWN:
                    entry["inputs"][given.GetBaseName()] = found
            if graph.unknown:
                what = "nodes that are not supported: %s. Inputs that depend on these nodes keep their defaults; a mix of two constants by an amount that is not constant uses half of each"
                writer.warn(prim.GetPath(), what % ", ".join(sorted(graph.unknown)))
            return entry
        if kind not in unknown:
            unknown.append(kind)
    # No surface shader is known, so report why the display colour is used.
    entry["place"] = str(prim.GetPath())
    if unknown:
        shown = ", ".join(kind or "one without an id" for kind in unknown)
        writer.warn(prim.GetPath(), "the material's surface shader (%s) is not supported; the display colour is used" % shown)
    elif needs_materialx(prim):
        missing = "the material is in a MaterialX file, which the installed OpenUSD cannot open (run `lumistack setup usd --materialx`, or `pip install usd-exchange` instead of usd-core)"
        writer.warn(prim.GetPath(), missing + "; the display colour is used")
    elif any(output.GetAttr().GetConnections() for output in source.GetSurfaceOutputs()):
        writer.warn(prim.GetPath(), "the material's surface output leads to no shader; the display colour is used")
    return entry


def needs_materialx(prim):
    """Returns true if a prim, or one of its ancestors, refers to a MaterialX file that OpenUSD
    cannot open.
    """
    if Sdf.FileFormat.FindByExtension("mtlx"):
        return False
    while prim and not prim.IsPseudoRoot():
        for spec in prim.GetPrimStack():
            arcs = spec.referenceList.GetAddedOrExplicitItems() + spec.payloadList.GetAddedOrExplicitItems()
            if any(arc.assetPath.endswith(".mtlx") for arc in arcs):
                return True
        prim = prim.GetParent()
    return False


def numbers(value):
    """Returns a number or a vector of floats as a list, or None for a value of another type."""
    if isinstance(value, (bool, int, float)):
        return [float(value)]
    if isinstance(value, (Gf.Vec2f, Gf.Vec3f, Gf.Vec4f, Gf.Vec2d, Gf.Vec3d, Gf.Vec4d, Gf.Vec2h, Gf.Vec3h, Gf.Vec4h)):
        return [float(part) for part in value]
    return None


def linear(values, space):
    """Converts a constant colour from a space in SRGB or from ACEScg to linear Rec. 709. All spaces
    in SRGB get the curve of sRGB. Colours of other spaces stay unchanged."""
    if space in SRGB:
        return [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values[:3]] + values[3:]
    if space in ("acescg", "lin_ap1", "lin_ap1_scene") and len(values) >= 3:
        return [sum(m * v for m, v in zip(row, values)) for row in ACESCG] + values[3:]
    return values


def constant(values):
    return {"value": [float(value) for value in values]}


def widened(values, count):
    """Returns `count` numbers: repeats a single number; pads any other list with 0, or cuts it."""
    return (list(values) * count)[:count] if len(values) == 1 else (list(values) + [0.0] * count)[:count]


def fallback(found, count):
    """Returns a constant input as `count` numbers. None if the input is not constant."""
    return None if found is None or "value" not in found else constant(widened(found["value"], count))


class Graph:
    """Follows connections from the inputs of a shader."""

    def __init__(self, writer, time, model):
        self.writer, self.time, self.model = writer, time, model
        self.depth = 0
        self.unknown = set()

    # Inputs

    def producer(self, given):
        """Returns the source of an input as (attribute, shader, output name). A constant has only
        the attribute. A connected shader has only shader and output name. All are None without a
        source."""
        if not given:
            return None, None, None
        found = UsdShade.Utils.GetValueProducingAttributes(given)
        if not found:
            return None, None, None
        attribute = found[0]
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Output:
            return None, UsdShade.Shader(attribute.GetPrim()), attribute.GetName().split(":", 1)[-1]
        return attribute, None, None

    def input(self, given):
        """Returns the value of an input. None if the input has no value of a known type, or, after
        a warning, if the value cannot be used."""
        attribute, shader, output = self.producer(given)
        if attribute:
            values = numbers(attribute.Get(self.time))
            if values is None:
                value = attribute.Get(self.time)
                return {"text": str(value)} if isinstance(value, str) else None
            if not all(math.isfinite(value) for value in values):
                self.writer.warn(attribute.GetPath(), "the value is not finite and is left out")
                return None
            if "color" in str(attribute.GetTypeName()):
                values = linear(values, attribute.GetColorSpace())
            return constant(values)
        if not shader:
            return None
        if self.depth > 50:
            self.writer.warn(shader.GetPath(), "the shader is in a cycle of shaders, or at the end of a chain of more than 50 shaders; the input keeps its default")
            return None
        self.depth += 1
        found = self.node(shader, output)
        self.depth -= 1
        return found

    def get(self, shader, name):
        """Returns the value of a shader's input."""
        return self.input(shader.GetInput(name))

    def value(self, shader, name, default):
        """Returns the value of a constant input, or `default` if the input has no value. For an
        input that is not constant, warns and returns `default`."""
        found = self.get(shader, name)
        if found is None:
            return default
        if "value" not in found:
            self.writer.warn(shader.GetPath(), "the shader's input %s is not a constant; %s is used" % (name, default))
            return default
        return widened(found["value"], len(default)) if isinstance(default, list) else found["value"][0]

    def text(self, shader, name, default):
        attribute = self.producer(shader.GetInput(name))[0]
        value = attribute.Get(self.time) if attribute else None
        return default if value is None else str(value)

    # Nodes

    def node(self, shader, output):
        """Returns the value of a node's output."""
        kind = str(shader.GetIdAttr().Get() or "")
        if kind.startswith(("UsdUVTexture", "ND_UsdUVTexture")):
            return self.preview_texture(shader, output)
        if "UsdPrimvarReader" in kind or kind.startswith("ND_geompropvalue"):
            return self.primvar(shader, kind)
        if kind.startswith(("ND_image_", "ND_tiledimage_")):
            return self.image(shader, kind)
        if kind.startswith("ND_normalmap"):
            return self.normal_map(shader)
        if kind.startswith("ND_"):
            return self.operation(shader, kind, output)
        self.unknown.add(kind or "a node without an id")
        return UNKNOWN

    def primvar(self, shader, kind):
        name = self.text(shader, "varname", None) or self.text(shader, "geomprop", None) or "st"
        if name == "displayColor":
            return {"primvar": name}
        # Other primvars are not supported; use the reader's fallback.
        found = self.get(shader, "fallback") or self.get(shader, "default")
        self.writer.warn(shader.GetPath(), "the shader reads the primvar %s as a value, but only displayColor is supported; the shader's fallback is used" % name)
        return found

    def preview_texture(self, shader, output):
        back = self.value(shader, "fallback", self.value(shader, "default", [0.0, 0.0, 0.0, 1.0]))
        scale, bias = self.value(shader, "scale", [1.0] * 4), self.value(shader, "bias", [0.0] * 4)
        channels = OUTPUT_CHANNELS.get(output, [0, 1, 2])
        picked = [back[c] for c in channels]
        image = self.picture(shader)
        if image is None:
            return constant(picked)
        wraps = []
        for name in ("wrapS", "wrapT"):
            mode = self.text(shader, name, "useMetadata")
            wraps.append(mode if mode in ("black", "clamp", "repeat", "mirror") else "repeat")
        texture = {
            "image": image,
            "channels": channels,
            "scale": [scale[c] for c in channels],
            "bias": [bias[c] for c in channels],
            "fallback": picked,
            "wrap": wraps,
            "color_space": self.color_space(shader, self.text(shader, "sourceColorSpace", "auto")),
        }
        texture["primvar"], texture["transform"] = self.coordinates(shader.GetInput("st"), 0)
        return {"texture": texture}

    def image(self, shader, kind):
        """Returns the texture of a MaterialX node `image` or `tiledimage`."""
        count = SIZES.get(kind.split("_")[2], 3)
        back = self.value(shader, "default", [0.0] * count)
        image = self.picture(shader)
        if image is None:
            return constant(back)
        modes = [self.text(shader, name, "periodic") for name in ("uaddressmode", "vaddressmode")]
        texture = {
            "image": image,
            "channels": list(range(count)),
            "scale": [1.0] * count,
            "bias": [0.0] * count,
            "fallback": back,
            "wrap": [ADDRESS_MODES.get(mode, "repeat") for mode in modes],
            # MaterialX converts only colours, and converts them only if the input names a colour
            # space.
            "color_space": self.color_space(shader, "raw") if "color" in kind else "raw",
        }
        texture["primvar"], transform = self.coordinates(shader.GetInput("texcoord"), 0)
        if kind.startswith("ND_tiledimage"):
            tiling, offset = self.value(shader, "uvtiling", [1.0, 1.0]), self.value(shader, "uvoffset", [0.0, 0.0])
            transform = composed([tiling[0], 0.0, 0.0, tiling[1], -offset[0], -offset[1]], transform)
        texture["transform"] = transform
        return {"texture": texture}

    def color_space(self, shader, default):
        attribute = self.producer(shader.GetInput("file"))[0]
        return (attribute.GetColorSpace() if attribute and attribute.HasColorSpace() else None) or default

    def normal_map(self, shader):
        """Returns a normal map in tangent space, with the codes 0..1 mapped to −1..1. None if there is
        no such map."""
        found = self.get(shader, "in")
        if found is None or "texture" not in found:
            return None
        # With the space "object" the node only decodes the picture. UsdPreviewSurface reads a
        # decoded vector as tangent space, so for this shader the two spaces do not differ.
        if self.text(shader, "space", "tangent") != "tangent" and self.model != "UsdPreviewSurface":
            self.writer.warn(shader.GetPath(), "the normal map is in object space, which is not supported; the normal map is left out")
            return None
        scale = self.value(shader, "scale", [1.0, 1.0])
        texture = rescaled(found["texture"], [2.0] * 3, [-1.0] * 3)
        return {"texture": rescaled(texture, [scale[0], scale[1], 1.0], [0.0] * 3)}

    def operation(self, shader, kind, output):
        """Computes the result of an arithmetic node of MaterialX. The node's inputs may be
        constants. They may be textures if the result is a texture with another scale and bias."""
        parts = kind[3:].split("_")
        name = parts[0]
        if name == "convert":
            count = SIZES.get(parts[-1], 3)
            return self.converted(self.get(shader, "in"), count)
        if name in ("constant", "dot"):
            found = self.get(shader, "value") if name == "constant" else self.get(shader, "in")
            return found
        if name in FRAME:
            # These nodes return the surface's own normal or tangent. With the result None, the
            # input keeps its default. The default is the same vector, so nothing is lost.
            return None
        if name in OPERATIONS:
            # a suffix such as FA has the types of the inputs
            count = SIZES.get(parts[1].rstrip("ACFV"), 3)
            found = getattr(self, "do_" + name.rstrip("234"))(shader, count, output)
            if found is not None:
                return found
        self.unknown.add(kind[3:])
        return UNKNOWN

    def converted(self, found, count):
        if found is None or found is UNKNOWN:
            return found
        if "value" in found:
            return constant(widened(found["value"], count))
        if "texture" in found:
            texture = dict(found["texture"])
            for key in ("channels", "scale", "bias", "fallback"):
                values = texture[key]
                texture[key] = (values * count)[:count] if len(values) == 1 else (values + values[-1:] * count)[:count]
            return {"texture": texture}
        return found

    def both(self, shader, count):
        """Returns the values of a node's two inputs, `in1` and `in2`."""
        first, second = self.get(shader, "in1"), self.get(shader, "in2")
        return first, second

    def do_add(self, shader, count, output, sign=1.0):
        first, second = self.both(shader, count)
        zero = constant([0.0] * count)
        first, second = first or zero, second or zero
        if "value" in first and "value" in second:
            return constant([a + sign * b for a, b in zip(widened(first["value"], count), widened(second["value"], count))])
        if "texture" in first and "value" in second:
            return {"texture": rescaled(first["texture"], [1.0] * count, [sign * b for b in widened(second["value"], count)])}
        if "value" in first and "texture" in second:
            return {"texture": rescaled(second["texture"], [sign] * count, widened(first["value"], count))}
        return None

    def do_subtract(self, shader, count, output):
        return self.do_add(shader, count, output, -1.0)

    def do_multiply(self, shader, count, output):
        first, second = self.both(shader, count)
        one = constant([1.0] * count)
        first, second = first or one, second or one
        if "value" in first and "value" in second:
            return constant([a * b for a, b in zip(widened(first["value"], count), widened(second["value"], count))])
        for texture, factor in ((first, second), (second, first)):
            if "texture" in texture and "value" in factor:
                return {"texture": rescaled(texture["texture"], widened(factor["value"], count), [0.0] * count)}
        return None

    def do_divide(self, shader, count, output):
        first, divisor = self.both(shader, count)
        divisors = widened(divisor["value"], count) if divisor and "value" in divisor else None
        if first is None or divisors is None or not all(divisors):
            return None
        if "value" in first:
            return constant([a / b for a, b in zip(widened(first["value"], count), divisors)])
        if "texture" in first:
            return {"texture": rescaled(first["texture"], [1.0 / b for b in divisors], [0.0] * count)}
        return None

    def do_invert(self, shader, count, output):
        found, amount = self.get(shader, "in"), self.value(shader, "amount", [1.0])
        if found and "value" in found:
            return constant([amount[0] - value for value in widened(found["value"], count)])
        if found and "texture" in found:
            return {"texture": rescaled(found["texture"], [-1.0] * count, [amount[0]] * count)}
        return None

    def do_mix(self, shader, count, output):
        front, back, share = self.get(shader, "fg"), self.get(shader, "bg"), self.get(shader, "mix")
        # MaterialX mixes by 0 if the amount is missing, which shows only the background.
        share = share or constant([0.0])
        zero = constant([0.0] * count)
        front, back = front or zero, back or zero
        if "value" in share:
            share = share["value"][0]
            # A mix of a texture and a constant is a scale and a bias of the texture.
            for texture, other, weight in ((front, back, share), (back, front, 1.0 - share)):
                if "texture" in texture and "value" in other:
                    rest = [(1.0 - weight) * value for value in widened(other["value"], count)]
                    return {"texture": rescaled(texture["texture"], [weight] * count, rest)}
        else:
            self.unknown.add("mix by an amount that is not constant")
            share = 0.5
        front, back = fallback(front, count), fallback(back, count)
        if front is None or back is None:
            return None
        return constant([b + (f - b) * share for f, b in zip(front["value"], back["value"])])

    def do_normalize(self, shader, count, output):
        found = self.get(shader, "in")
        if found and "value" in found:
            values = widened(found["value"], count)
            length = math.sqrt(sum(value * value for value in values))
            return constant([value / length for value in values] if length > 0.0 else values)
        # A normal map needs no change, since only the direction of its vectors has an effect.
        return found

    def do_transformnormal(self, shader, count, output):
        """Returns the input unchanged: the renderer reads every normal map in tangent space, so a
        change of its space has no effect."""
        return self.get(shader, "in")

    do_transformvector = do_transformnormal

    def do_clamp(self, shader, count, output):
        return self.clamped(shader, self.get(shader, "in"), ("low", "high"), count)

    def clamped(self, shader, found, limits, count):
        """Clamps a value to two inputs of a shader, whose names are `limits`."""
        low, high = (widened(self.value(shader, name, [default]), count) for name, default in zip(limits, (0.0, 1.0)))
        if found and "value" in found:
            return constant([min(max(v, a), b) for v, a, b in zip(widened(found["value"], count), low, high)])
        if found and "texture" in found:
            # A clamp has no effect if its limits enclose the values that the texels 0 and 1 give.
            pairs = zip(found["texture"]["scale"], found["texture"]["bias"], low, high)
            if all(a <= min(bias, scale + bias) and max(bias, scale + bias) <= b for scale, bias, a, b in pairs):
                return found
        return None

    def do_remap(self, shader, count, output):
        """Maps the range from inlow to inhigh to the range from outlow to outhigh."""
        found = self.get(shader, "in")
        ends = {"inlow": 0.0, "inhigh": 1.0, "outlow": 0.0, "outhigh": 1.0}
        ends = {name: widened(self.value(shader, name, [default]), count) for name, default in ends.items()}
        spans = [high - low for low, high in zip(ends["inlow"], ends["inhigh"])]
        if found is None or not all(spans):
            return None
        scale = [(high - low) / span for low, high, span in zip(ends["outlow"], ends["outhigh"], spans)]
        bias = [low - s * start for low, s, start in zip(ends["outlow"], scale, ends["inlow"])]
        if "value" in found:
            return constant([s * v + b for s, v, b in zip(scale, widened(found["value"], count), bias)])
        return {"texture": rescaled(found["texture"], scale, bias)} if "texture" in found else None

    def do_range(self, shader, count, output):
        if self.value(shader, "gamma", 1.0) != 1.0:
            return None
        found = self.do_remap(shader, count, output)
        return self.clamped(shader, found, ("outlow", "outhigh"), count) if self.value(shader, "doclamp", 0.0) else found

    def do_extract(self, shader, count, output):
        return picked(self.get(shader, "in"), [int(self.value(shader, "index", 0.0))])

    def do_separate(self, shader, count, output):
        order = {"outr": 0, "outg": 1, "outb": 2, "outa": 3, "outx": 0, "outy": 1, "outz": 2, "outw": 3}
        return picked(self.get(shader, "in"), [order.get(output, 0)])

    def do_swizzle(self, shader, count, output):
        order = {"r": 0, "g": 1, "b": 2, "a": 3, "x": 0, "y": 1, "z": 2, "w": 3}
        letters = self.text(shader, "channels", "")
        return picked(self.get(shader, "in"), [order[letter] for letter in letters if letter in order])

    def do_combine(self, shader, count, output):
        widths = WIDTHS.get(str(shader.GetIdAttr().Get()).split("_")[2], [1] * count)
        parts = []
        for number, width in enumerate(widths, 1):
            found = self.get(shader, "in%d" % number)
            parts += [constant([0.0]) if found is None else picked(found, [i]) for i in range(width)]
        if None in parts:
            return None
        textures = [found["texture"] for found in parts if "texture" in found]
        if not textures:
            return constant([found["value"][0] for found in parts]) if all("value" in found for found in parts) else None
        # If all channels come from one picture with equal texture coordinates, they become one
        # texture. An example is a normal map whose green channel is inverted.
        first = textures[0]
        shared = ("image", "wrap", "color_space", "primvar", "transform")
        if any(texture[key] != first[key] for texture in textures for key in shared):
            return None
        combined = dict(first, channels=[], scale=[], bias=[], fallback=[])
        for found in parts:
            if "texture" in found:
                picked_part = {key: found["texture"][key][0] for key in ("channels", "scale", "bias", "fallback")}
            else:
                # A constant becomes a channel with scale 0 and the constant as bias.
                value = found["value"][0]
                picked_part = {"channels": first["channels"][0], "scale": 0.0, "bias": value, "fallback": value}
            for key, value in picked_part.items():
                combined[key].append(value)
        return {"texture": combined}

    # Textures

    def picture(self, shader):
        """Returns the index of a texture's image, or None if the shader names no file. A file that does
        not exist gives None and a warning."""
        attribute = self.producer(shader.GetInput("file"))[0]
        asset = attribute.Get(self.time) if attribute else None
        path = getattr(asset, "path", "")
        if not path:
            return None
        resolved = str(asset.resolvedPath)
        if "<UDIM>" in path:
            self.writer.warn(attribute.GetPath(), "%s: only tile 1001 of a tiled texture (UDIM) is used" % path)
            resolved = self.tile(attribute, path.replace("<UDIM>", "1001"))
        if not resolved:
            self.writer.warn(attribute.GetPath(), "%s does not exist; the texture's fallback colour is used" % path)
            return None
        self.writer.file(resolved)
        return self.writer.image(resolved, lambda: self.image_entry(attribute, path, resolved))

    def tile(self, attribute, path):
        for spec in attribute.GetPropertyStack(self.time):
            found = Ar.GetResolver().Resolve(Sdf.ComputeAssetPathRelativeToLayer(spec.layer, path))
            if found:
                return str(found)
        return ""

    def image_entry(self, attribute, path, resolved):
        return image_entry(self.writer, attribute.GetPath(), path, resolved)

    # Texture coordinates

    def coordinates(self, given, depth):
        """Returns the primvar of texture coordinates, and the affine map that is applied to its
        values."""
        attribute, shader, _ = self.producer(given)
        if not shader or depth > 50:
            return "st", IDENTITY
        kind = str(shader.GetIdAttr().Get() or "")
        # Primvar readers end the chain.
        if "UsdPrimvarReader" in kind:
            return self.text(shader, "varname", "st"), IDENTITY
        if kind.startswith("ND_geompropvalue"):
            return self.text(shader, "geomprop", "st"), IDENTITY
        if kind.startswith("ND_texcoord"):
            index = int(self.value(shader, "index", 0.0))
            return "st" if index == 0 else "st%d" % index, IDENTITY
        # Transform nodes apply an affine map after the map of their input.
        if "UsdTransform2d" in kind:
            name, before = self.coordinates(shader.GetInput("in"), depth + 1)
            scale, shift = self.value(shader, "scale", [1.0, 1.0]), self.value(shader, "translation", [0.0, 0.0])
            turn = math.radians(self.value(shader, "rotation", 0.0))
            cosine, sine = math.cos(turn), math.sin(turn)
            own = [scale[0] * cosine, scale[0] * sine, -scale[1] * sine, scale[1] * cosine, shift[0], shift[1]]
            return name, composed(own, before)
        if kind.startswith("ND_place2d"):
            name, before = self.coordinates(shader.GetInput("texcoord"), depth + 1)
            pivot, scale = self.value(shader, "pivot", [0.0, 0.0]), self.value(shader, "scale", [1.0, 1.0])
            shift, turn = self.value(shader, "offset", [0.0, 0.0]), math.radians(self.value(shader, "rotate", 0.0))
            if not all(scale):
                return name, before
            cosine, sine = math.cos(turn), math.sin(turn)
            # MaterialX subtracts the pivot, divides by the scale, rotates by −rotate, subtracts the
            # offset, and adds the pivot. A positive angle turns the picture counter-clockwise.
            steps = (
                [1.0, 0.0, 0.0, 1.0, -pivot[0], -pivot[1]],
                [1.0 / scale[0], 0.0, 0.0, 1.0 / scale[1], 0.0, 0.0],
                [cosine, -sine, sine, cosine, 0.0, 0.0],
                [1.0, 0.0, 0.0, 1.0, pivot[0] - shift[0], pivot[1] - shift[1]],
            )
            for step in steps:
                before = composed(step, before)
            return name, before
        for operation, place in (("ND_multiply_vector2", 0), ("ND_divide_vector2", 1), ("ND_add_vector2", 2), ("ND_subtract_vector2", 3)):
            if kind.startswith(operation):
                name, before = self.coordinates(shader.GetInput("in1"), depth + 1)
                a, b = self.value(shader, "in2", [1.0, 1.0] if place < 2 else [0.0, 0.0])
                if place == 1 and not (a and b):
                    return name, before
                own = (
                    [a, 0.0, 0.0, b, 0.0, 0.0],
                    [1.0 / (a or 1.0), 0.0, 0.0, 1.0 / (b or 1.0), 0.0, 0.0],
                    [1.0, 0.0, 0.0, 1.0, a, b],
                    [1.0, 0.0, 0.0, 1.0, -a, -b],
                )[place]
                return name, composed(own, before)
        self.writer.warn(shader.GetPath(), "the node %s is not supported for texture coordinates; the primvar st is used" % (kind or "without an id"))
        return "st", IDENTITY


def image_entry(writer, place, path, resolved):
    """Returns the entry of a picture: a path on disk, or the bytes of a file in a package."""
    entry = {"place": str(place), "name": path, "path": resolved}
    if Ar.IsPackageRelativePath(resolved):
        entry["path"] = None
        try:
            entry["bytes"] = writer.array(packaged(resolved))
        except (OSError, KeyError, zipfile.BadZipFile) as error:
            writer.warn(place, "the picture %s cannot be read from the USDZ package: %s" % (path, error))
    return entry


def packaged(path):
    """Returns the bytes of a file in a package, `package.usdz[file]`; packages may be nested."""
    file, inner = Ar.SplitPackageRelativePathOuter(path)
    while True:
        name, rest = Ar.SplitPackageRelativePathOuter(inner)
        with zipfile.ZipFile(file) as package:
            found = package.read(name)
        if not rest:
            return found
        import io

        file, inner = io.BytesIO(found), rest


def composed(after, before):
    """Returns the composition of two affine maps: first `before`, then `after`."""
    a, b, c, d, x, y = after
    e, f, g, h, u, v = before
    return [a * e + c * f, b * e + d * f, a * g + c * h, b * g + d * h, a * u + c * v + x, b * u + d * v + y]


def rescaled(texture, scale, bias):
    """Returns the texture whose components are scale · component + bias."""
    found = dict(texture)
    count = max(len(texture["channels"]), len(scale))
    for key in ("channels", "scale", "bias", "fallback"):
        values = texture[key]
        found[key] = (values * count)[:count] if len(values) == 1 else list(values)
    count = len(found["channels"])
    scale, bias = widened(scale, count), widened(bias, count)
    found["scale"] = [s * own for s, own in zip(scale, found["scale"])]
    found["bias"] = [s * own + b for s, own, b in zip(scale, found["bias"], bias)]
    found["fallback"] = [s * own + b for s, own, b in zip(scale, found["fallback"], bias)]
    return found


def picked(found, order):
    """Returns the components `order` of an input's value. A component that a constant lacks is 0. None
    if a texture lacks a component, or if the input is neither a constant nor a texture."""
    if found is None or not order:
        return None
    if "value" in found:
        values = found["value"]
        return constant([values[i] if i < len(values) else 0.0 for i in order])
    if "texture" not in found:
        return None
    texture = dict(found["texture"])
    if max(order) >= len(texture["channels"]):
        return None
    for key in ("channels", "scale", "bias", "fallback"):
        texture[key] = [texture[key][i] for i in order]
    return {"texture": texture}
