"""Converts a stage to a scene package: the prims that are visible at one time, and their transforms
and materials.

Prototypes of native instancing and of point instancers are read once. A placement is a chain of
links, the innermost first. The links transform a point one after another, from left to right (`p' =
p · M`, row vectors as in USD). A link is one matrix, or an array of matrices, which makes one copy
per matrix. """

import array
import os

from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel

from lumistack_usd import geometry, lights, materials, mtlx, shapes, splats
from lumistack_usd.skel import Skeletons, source
from lumistack_usd.writer import Refused, Writer

IDENTITY = Gf.Matrix4d(1)
SHOWN = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
# Prototypes may be inside an `over` or a `class`, which hides them where they are defined. So this
# predicate also accepts prims that are abstract, or whose ancestors are not defined.
IN_PROTOTYPE = Usd.TraverseInstanceProxies(Usd.PrimIsActive & Usd.PrimIsLoaded & Usd.PrimHasDefiningSpecifier)
ANYWHERE = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
INHERITED_PRIMVARS = ("primvars:displayColor", "primvars:displayOpacity")


def walk(request, stage=None):
    """Reads `stage` or, if it is None, the file that the request names. Returns a `Writer`."""
    with mtlx.definitions():
        return walk_stage(stage or open_stage(request["path"]), request)


def open_stage(path):
    try:
        return Usd.Stage.Open(path)
    except Tf.ErrorException as error:
        raise Refused(errors(error)) from None


def errors(error):
    """Returns the messages of a pxr exception, without positions in pxr's source code."""
    texts = [getattr(part, "commentary", None) or str(part) for part in error.args] or [str(error)]
    # OpenUSD adds "Failed to open layer", which repeats the first message.
    texts = [text for text in texts if not text.startswith("Failed to open layer")] or texts
    return "; ".join(dict.fromkeys(" ".join(text.split()) for text in texts))


def walk_stage(stage, request):
    """Reads a stage. `request` may have `time_s`, `variants` (texts), `contents_only`."""
    writer = Writer()
    choose_variants(stage, request.get("variants") or [], writer)
    time = time_code(stage, request.get("time_s"))
    warn_of_composition(stage, writer)
    writer.header.update(
        name=stage.GetRootLayer().GetDisplayName(),
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        meters_per_unit=meters_per_unit(stage),
        contents=contents(stage),
    )
    if not request.get("contents_only"):
        Walker(stage, writer, time).run()
    for layer in stage.GetUsedLayers():
        writer.file(layer.realPath)
    return writer


def meters_per_unit(stage):
    """Returns the stage's unit, in metres. Some programs store it as a 32-bit number, which
    UsdGeom's own function refuses."""
    value = stage.GetMetadata("metersPerUnit")
    return float(value) if isinstance(value, (int, float)) and value > 0 else UsdGeom.LinearUnits.centimeters


def composition_errors(stage):
    """Yields layers and references that OpenUSD could not compose, as (place, message)."""
    # OpenUSD 24.08 and newer list these errors per stage, older versions per prim and layer.
    if hasattr(stage, "GetCompositionErrors"):
        for error in stage.GetCompositionErrors():
            site = getattr(error, "rootSite", None)
            yield (site.path if site else "/"), str(error)
        return
    for prim in Usd.PrimRange.Stage(stage, Usd.PrimAllPrimsPredicate):
        for error in prim.GetPrimIndex().localErrors:
            yield prim.GetPath(), str(error)
    for layer in stage.GetUsedLayers():
        for path in layer.subLayerPaths:
            if not Sdf.Layer.FindOrOpenRelativeToLayer(layer, path):
                yield "/", "Could not load sublayer @%s@ of layer @%s@; skipping." % (path, layer.identifier)


def warn_of_composition(stage, writer):
    """Warns of layers and references that OpenUSD could not compose. The scene is shown without
    them, as in every USD program."""
    without_materialx = 0
    for place, message in composition_errors(stage):
        if ".mtlx" in message and "Could not open" in message and not Sdf.FileFormat.FindByExtension("mtlx"):
            without_materialx += 1
            continue
        writer.warn(place, message)
    if without_materialx:
        writer.warn(
            "/",
            "references to MaterialX files (.mtlx) are left out (count: %d), since the installed OpenUSD has no MaterialX plugin. The Python package usd-exchange"
            " has one: run `lumistack setup usd --materialx`, or `pip install usd-exchange` instead of usd-core" % without_materialx,
        )


def time_code(stage, time_s):
    """Returns the time code `time_s` seconds after the stage's first time code, or after 0 if the
    stage has none. If `time_s` is None, returns the first time code, or else the earliest time."""
    start = stage.GetStartTimeCode() if stage.HasAuthoredTimeCodeRange() else None
    if time_s is not None:
        return Usd.TimeCode((start or 0.0) + time_s * stage.GetTimeCodesPerSecond())
    return Usd.TimeCode.EarliestTime() if start is None else Usd.TimeCode(start)


def variant_sets(stage):
    """Yields the variant sets of the stage's defined prims, also inside instances, as (prim, name,
    choices, selection)."""
    for prim in Usd.PrimRange.Stage(stage, ANYWHERE):
        if prim.HasVariantSets():
            sets = prim.GetVariantSets()
            for name in sets.GetNames():
                found = sets.GetVariantSet(name)
                yield prim, name, found.GetVariantNames(), found.GetVariantSelection()


def choose_variants(stage, wanted, writer):
    """Selects variants: `set=variant` on every prim with the set, `/prim{set=variant}` on one prim.
    """
    if not wanted:
        return
    # Select variants in the session layer, so that the file stays unchanged.
    stage.SetEditTarget(stage.GetSessionLayer())
    for text in wanted:
        path, _, rest = text.rpartition("{")
        name, _, variant = rest.rstrip("}").partition("=")
        found, known = False, {}
        # A variant may add prims with further variants. So repeat until nothing changes, at most 8
        # times.
        for _ in range(8):
            changed = False
            for prim, set_name, choices, selection in list(variant_sets(stage)):
                place = "%s{%s}" % (prim.GetPath(), set_name)
                known[place] = "%s: %s" % (place, ", ".join(choices))
                if set_name != name or variant not in choices or (path and prim.GetPath() != path):
                    continue
                found = True
                if selection != variant:
                    if prim.IsInstanceProxy():
                        writer.warn(place, "the variant set is inside an instance, so its variant cannot be chosen")
                        continue
                    prim.GetVariantSet(name).SetVariantSelection(variant)
                    changed = True
            if not changed:
                break
        else:
            writer.warn(text, "each of eight searches of the stage selected the variant on more prims; variant sets that the last selection added may keep the file's own variants")
        if not found:
            shown = list(known.values())
            listed = "; ".join(shown[:12]) + ("; and %d more" % (len(shown) - 12) if len(shown) > 12 else "")
            raise Refused("expected %s, found the variant %s" % ("one of the variants (%s)" % listed if listed else "no variant, since the file has none", text))


def contents(stage):
    """Returns the file's variant sets, cameras and time range, and its numbers of prims, meshes and
    points of meshes."""
    sets = [
        {"place": "%s{%s}" % (prim.GetPath(), name), "choices": list(choices), "selected": selection}
        for prim, name, choices, selection in variant_sets(stage)
        if not prim.IsInstanceProxy()
    ]
    prims = meshes = points = 0
    cameras, time = [], time_code(stage, None)
    for prim in stage.Traverse():
        prims += 1
        if prim.IsA(UsdGeom.Mesh):
            meshes += 1
            values = UsdGeom.Mesh(prim).GetPointsAttr().Get(time)
            points += len(values) if hasattr(values, "__len__") else 0
        elif prim.IsA(UsdGeom.Camera):
            cameras.append(str(prim.GetPath()))
    found = {"variant_sets": sets, "cameras": cameras, "prims": prims, "meshes": meshes, "points": points}
    if stage.HasAuthoredTimeCodeRange():
        codes = [stage.GetStartTimeCode(), stage.GetEndTimeCode()]
        rate = stage.GetTimeCodesPerSecond()
        found["time_range"] = {"time_codes": codes, "time_codes_per_second": rate}
    return found


class Walker:
    """Visits the visible prims of a stage."""

    def __init__(self, stage, writer, time):
        self.stage, self.writer, self.time = stage, writer, time
        self.geometries = {}
        self.frames = {}
        self.open_frames = []
        self.materials = {}
        self.skeletons = Skeletons(time)

    def run(self):
        placed = self.frame(self.stage.GetPseudoRoot(), ANYWHERE, children_only=True)
        groups = {}
        for kind, payload, links in placed:
            if kind == "geometry":
                if len(links) == 1:
                    groups.setdefault(payload, array.array("d")).frombytes(memoryview(links[0]).cast("B"))
                else:
                    self.instances(payload, [self.link(link) for link in links])
            else:
                self.single(kind, payload, links)
        for payload, matrices in groups.items():
            self.instances(payload, [{"matrices": self.matrices(matrices)}])
        self.put_preferred_camera_first()

    def matrices(self, values):
        reference = self.writer.array(values)
        reference["shape"] = [len(values) // 16, 4, 4]
        return reference

    def link(self, link):
        if isinstance(link, dict):
            return link
        return {"matrices": self.matrices(array.array("d", memoryview(link).cast("B").cast("d")))}

    def instances(self, payload, chain):
        index, bound = payload
        self.writer.instances.append({"geometry": index, "materials": list(bound), "chain": chain})

    def single(self, kind, entry, links):
        """Adds a light or a camera. A light or camera inside a point instancer is left out with a
        warning."""
        if len(links) != 1:
            self.writer.warn(entry["place"], "a %s inside a point instancer is left out" % kind)
            return
        placed = dict(entry, matrix=[value for row in links[0] for value in row])
        (self.writer.lights if kind == "light" else self.writer.cameras).append(placed)

    # Prims

    def frame(self, root, predicate, children_only=False):
        """Returns all visible content of a prim and its descendants, each object as (kind, payload,
        links). The links transform the object to the space of the prim's parent."""
        placed = []
        info = UsdGeom.Imageable(root).ComputePurposeInfo() if not root.IsPseudoRoot() else None
        todo = [(root, IDENTITY, info)]
        if children_only:
            todo = [(child, IDENTITY, info) for child in reversed(root.GetFilteredChildren(predicate))]
        while todo:
            prim, above, parent = todo.pop()
            imageable = UsdGeom.Imageable(prim)
            if not imageable and not splats.is_field(prim):
                # A prim that USD does not show, for example a prim without a type: only its
                # children may be visible.
                todo.extend((child, above, parent) for child in reversed(prim.GetFilteredChildren(predicate)))
                continue
            if imageable.GetVisibilityAttr().Get(self.time) == UsdGeom.Tokens.invisible:
                continue
            purpose = imageable.ComputePurposeInfo(parent) if parent is not None else imageable.ComputePurposeInfo()
            matrix = self.attempt(self.matrix, prim, above)
            if matrix is None:
                continue
            if prim.IsA(UsdSkel.Root):
                self.skeletons.add(prim, self.writer)
            if prim.IsInstance():
                for kind, payload, links in self.prototype(prim, purpose):
                    placed.append((kind, payload, extended(links, matrix)))
                continue
            if prim.IsA(UsdGeom.PointInstancer):
                if purpose.purpose in SHOWN:
                    placed.extend(self.point_instancer(prim, matrix))
                continue
            if purpose.purpose in SHOWN:
                item = self.attempt(self.item, prim)
                if item:
                    placed.append(item + ((matrix,),))
            todo.extend((child, matrix, purpose) for child in reversed(prim.GetFilteredChildren(predicate)))
        return placed

    def attempt(self, read, prim, *rest):
        """Returns the result of `read` for a prim. If `read` fails, for example at a value of a
        wrong type, warns and returns None."""
        try:
            return read(prim, *rest)
        except (Tf.ErrorException, TypeError, ValueError, OverflowError) as error:
            self.writer.warn(prim.GetPath(), "the prim cannot be read and is left out: %s" % errors(error))
            return None

    def matrix(self, prim, above):
        xformable = UsdGeom.Xformable(prim)
        if not xformable and not splats.is_field(prim):
            return above
        local = xformable.GetLocalTransformation(self.time)
        if xformable.GetResetXformStack():
            if self.open_frames:
                self.writer.warn(prim.GetPath(), "the prim is inside a prototype and resets its transform; the transforms of the prototype's copies still apply to it")
            return local
        return local * above

    def item(self, prim):
        """Returns (kind, payload) of a shape, a light or a camera; None for other prims."""
        if splats.is_field(prim):
            # Splats have their own colours, so a bound material has no effect.
            return ("geometry", (self.geometry(prim)[0], (None,))) if splats.is_shown(prim, self.writer) else None
        if prim.IsA(UsdGeom.Mesh) or shapes.is_shape(prim, self.writer):
            index, subsets = self.geometry(prim)
            return "geometry", (index, (self.material(prim),) + tuple(self.material(subset) for subset in subsets))
        if prim.IsA(UsdGeom.Camera):
            return "camera", camera(prim, self.time)
        light = lights.light(prim, self.writer, self.time)
        return ("light", light) if light else None

    def geometry(self, prim):
        """Returns the index of a shape in the package, and the shape's subsets of faces that have
        their own materials. A shape in a prototype is read once for equal inherited colours and
        poses."""
        key = (source(prim).GetPath(), self.inherited_primvars(prim), self.skeletons.key(prim))
        if key not in self.geometries:
            if prim.IsA(UsdGeom.Mesh):
                entry = geometry.mesh(prim, self.writer, self.time, self.skeletons.pose(prim, self.writer))
            elif splats.is_field(prim):
                entry = splats.field(prim, self.writer, self.time)
            else:
                entry = shapes.shape(prim, self.writer, self.time)
            entry["light"] = lights.mesh_light(prim, self.writer, self.time)
            subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
            for subset in subsets:
                faces = subset.GetIndicesAttr().Get(self.time)
                if faces is not None:
                    entry["subsets"].append({"place": str(subset.GetPath()), "faces": self.writer.array(faces)})
            names = [subset.GetPrim().GetName() for subset in subsets if subset.GetIndicesAttr().Get(self.time) is not None]
            self.writer.geometries.append(entry)
            self.geometries[key] = (len(self.writer.geometries) - 1, names)
        index, names = self.geometries[key]
        return index, [prim.GetChild(name) for name in names]

    def inherited_primvars(self, prim):
        """Returns the display colour and opacity that a prim inherits, for the key of its shape."""
        found = UsdGeom.PrimvarsAPI(prim.GetParent()).FindInheritablePrimvars()
        return tuple(
            (primvar.GetName(), str(primvar.Get(self.time))) for primvar in found if primvar.GetName() in INHERITED_PRIMVARS
        )

    def bound(self, prim):
        """Returns the material bound to a prim, and the relationship that binds it."""
        api = UsdShade.MaterialBindingAPI(prim)
        for purpose in (UsdShade.Tokens.full, UsdShade.Tokens.preview):
            material, relationship = api.ComputeBoundMaterial(purpose)
            if material:
                return material, relationship
        return None, None

    def material(self, prim):
        """Returns the index of a prim's material, or None if it has none."""
        material, _ = self.bound(prim)
        if material is None:
            return None
        prim = material.GetPrim()
        key = source(prim).GetPath()
        if key not in self.materials:
            self.materials[key] = len(self.writer.materials)
            self.writer.materials.append(materials.material(prim, self.writer, self.time))
        return self.materials[key]

    # Instances

    def prototype(self, prim, purpose):
        """Returns the content of an instance, in the instance's own space."""
        material, relationship = self.bound(prim)
        key = (
            prim.GetPrototype().GetPath(),
            material.GetPath() if material else None,
            UsdShade.MaterialBindingAPI.GetMaterialBindingStrength(relationship) if relationship else None,
            purpose.purpose,
            purpose.isInheritable,
            self.inherited_primvars(prim.GetFilteredChildren(ANYWHERE)[0]) if prim.GetFilteredChildren(ANYWHERE) else (),
            prim.GetPath() if self.is_unlike_others(prim) else None,
            UsdSkel.BindingAPI(prim).GetInheritedAnimationSource().GetPath(),
            UsdSkel.BindingAPI(prim).GetInheritedSkeleton().GetPath(),
        )
        if key not in self.frames:
            self.open_frames.append(key)
            self.frames[key] = []
            for child in prim.GetFilteredChildren(ANYWHERE):
                self.frames[key] += self.frame(child, ANYWHERE)
            self.open_frames.pop()
        return self.frames[key]

    def is_unlike_others(self, prim):
        """Returns true if an instance may differ from other instances of its prototype: if the
        prim or an ancestor is a `UsdSkelRoot`, or binds materials by a collection."""
        while prim and not prim.IsPseudoRoot():
            if prim.IsA(UsdSkel.Root) or any("material:binding:collection" in name for name in prim.GetPropertyNames()):
                return True
            prim = prim.GetParent()
        return False

    def point_instancer(self, prim, matrix):
        """Returns the content of a point instancer's prototypes. Each object has a link with the
        matrices of all copies, and with the number of the object's prototype."""
        instancer = UsdGeom.PointInstancer(prim)
        place = prim.GetPath()
        if place in self.open_frames:
            self.writer.warn(place, "the instancer is part of its own prototype and is left out")
            return []
        # Compute the matrix of every copy.
        indices = instancer.GetProtoIndicesAttr().Get(self.time)
        if not indices:
            return []
        matrices = placements(instancer, self.time)
        if len(matrices) != len(indices):
            found = "%d prototype indices and %d placements" % (len(indices), len(matrices))
            self.writer.warn(place, "expected as many placements as prototype indices, found %s; the instancer is left out" % found)
            return []
        # All prototypes refer to these arrays. Each prototype selects its own copies from them.
        shared = {"matrices": self.writer.array(matrices), "prototypes": self.writer.array(indices)}
        mask = instancer.ComputeMaskAtTime(self.time)
        if mask and not all(mask):
            shared["mask"] = self.writer.array(array.array("B", [1 if shown else 0 for shown in mask]))
        placed = []
        self.open_frames.append(place)
        for number, target in enumerate(instancer.GetPrototypesRel().GetForwardedTargets()):
            root = self.stage.GetPrimAtPath(target)
            if not root:
                self.writer.warn(place, "the instancer's prototype %s does not exist; its copies are left out" % target)
                continue
            link = dict(shared, prototype=number)
            for kind, payload, links in self.frame(root, IN_PROTOTYPE):
                placed.append((kind, payload, links + (link, matrix)))
        self.open_frames.pop()
        return placed

    def put_preferred_camera_first(self):
        """Moves the preferred camera, which some programs record in the file, to the start of the
        list."""
        settings = self.stage.GetRootLayer().customLayerData.get("cameraSettings")
        preferred = settings.get("boundCamera") if isinstance(settings, dict) else None
        self.writer.cameras.sort(key=lambda entry: entry["place"] != preferred)


def placements(instancer, time):
    """Returns the matrices of all copies of a point instancer. Velocities are not read."""
    motion = instancer.GetVelocitiesAttr(), instancer.GetAccelerationsAttr(), instancer.GetAngularVelocitiesAttr()
    if any(attribute.HasAuthoredValue() for attribute in motion):
        # OpenUSD adds velocity · time to the positions of a sample, so copy all other attributes.
        # The variable `stage` keeps the copy's stage until the end of this function.
        stage = Usd.Stage.CreateInMemory()
        still = UsdGeom.PointInstancer.Define(stage, "/still")
        for name in ("protoIndices", "positions", "orientations", "orientationsf", "scales"):
            source, copy = (held.GetPrim().GetAttribute(name) for held in (instancer, still))
            found = source.Get(time) if source else None
            if found is not None and copy:
                copy.Set(found)
        instancer, time = still, Usd.TimeCode.Default()
    return instancer.ComputeInstanceTransformsAtTime(time, time, UsdGeom.PointInstancer.ExcludeProtoXform, UsdGeom.PointInstancer.IgnoreMask)


def extended(links, matrix):
    """Returns a chain that also applies `matrix`, after its last link."""
    if isinstance(links[-1], dict):
        return links + (matrix,)
    return links[:-1] + (links[-1] * matrix,)


def camera(prim, time):
    """Returns a camera's entry. Apertures and focal length are in tenths of the scene's unit."""
    source = UsdGeom.Camera(prim)
    values = source.GetCamera(time)
    return {
        "place": str(prim.GetPath()),
        "projection": str(source.GetProjectionAttr().Get(time)),
        "focal_length": values.focalLength,
        "aperture": [values.horizontalAperture, values.verticalAperture],
        "aperture_offset": [values.horizontalApertureOffset, values.verticalApertureOffset],
        "focus_distance": values.focusDistance,
        # If the file sets no clipping range, there is no near plane. The schema's default of one
        # unit is not used.
        "near": values.clippingRange.min if source.GetClippingRangeAttr().HasAuthoredValue() else None,
    }
