"""Finds content of a Blender scene that glTF cannot express: materials with unsupported nodes, hair,
volumes.

The export reduces a material to constants and pictures of a Principled BSDF. Blender's exporter
drops all other nodes without a warning. This module visits the nodes that a render evaluates and
lists the dropped nodes. """

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

#: Largest number of names in one line; the line states the number of further names.
MOST_NAMES = 8
#: Types of nodes that the exporter supports, or that do not change the picture.
FOLLOWED = frozenset(
    "OUTPUT_MATERIAL BSDF_PRINCIPLED EMISSION BACKGROUND BSDF_TRANSPARENT LIGHT_PATH TEX_IMAGE UVMAP TEX_COORD MAPPING NORMAL_MAP"
    " SEPARATE_COLOR SEPRGB VERTEX_COLOR ATTRIBUTE VALUE RGB REROUTE FRAME GROUP GROUP_INPUT GROUP_OUTPUT".split()
)
#: Operations of the node Math that the exporter reads as factors and thresholds.
FOLLOWED_MATH = ("MULTIPLY", "ROUND", "LESS_THAN", "SUBTRACT")
MIXED_SHADERS = ("MIX_SHADER", "ADD_SHADER")
#: Types of objects that are not exported.
LEFT_OUT = {"CURVES": "hair", "VOLUME": "volumes", "POINTCLOUD": "point clouds", "GREASEPENCIL": "drawings", "GPENCIL": "drawings"}
LINES = {
    "materials": "that Lumistack's path tracer shows as plain colours, since glTF lacks nodes of the materials",
    "hair": "that Lumistack's path tracer leaves out",
    "volumes": "that Lumistack's path tracer leaves out",
    "point clouds": "that Lumistack's path tracer leaves out",
    "drawings": "that Lumistack's path tracer leaves out",
}


def unshown(bpy: Any, scene: Any, depsgraph: Any = None) -> list[str]:
    """Returns a line for each kind of content that a render by Blender shows and the export loses;
    empty for most scenes."""
    found: dict[str, dict[str, None]] = {kind: {} for kind in LINES}
    judged: set[str] = set()
    # Check every visible object: its type, modifiers and materials.
    for held, shown in _rendered(bpy, scene, depsgraph):
        if shown.type in LEFT_OUT:
            found[LEFT_OUT[shown.type]][held.name] = None
        for modifier in held.modifiers:
            if not modifier.show_render:
                continue
            if _is_hair(modifier):
                found["hair"][held.name] = None
            if _is_smoke(modifier):
                found["volumes"][held.name] = None
        for material in _materials(shown):
            output = _output(material)
            if output is None:
                continue
            if output.inputs["Volume"].is_linked:
                found["volumes"][held.name] = None
            if material.name not in judged:
                judged.add(material.name)
                reasons = list(dict.fromkeys(_reasons(output)))
                if reasons:
                    found["materials"][f"{material.name} ({_listed(reasons)})"] = None
    world = scene.world
    if world is not None and world.node_tree is not None and any(
        node.type == "OUTPUT_WORLD" and node.is_active_output and node.inputs["Volume"].is_linked for node in world.node_tree.nodes
    ):
        found["volumes"][world.name] = None
    return [f"{kind} {LINES[kind]}: {_listed(list(names))}" for kind, names in found.items() if names]


def is_volume_alone(held: Any) -> bool:
    """Returns true if an object has a volume and no surface, such as a smoke domain. The box around
    such a volume must not be exported."""
    outputs = [_output(slot.material) for slot in held.material_slots if slot.material is not None]
    return bool(outputs) and all(
        output is not None and output.inputs["Volume"].is_linked and not output.inputs["Surface"].is_linked for output in outputs
    )


def is_rendered(held: Any) -> bool:
    """Returns true if an object, and at least one of its collections, is enabled for renders."""
    return not held.hide_render and not (held.users_collection and all(each.hide_render for each in held.users_collection))


def _listed(names: list[str]) -> str:
    shown = ", ".join(names[:MOST_NAMES])
    return shown if len(names) <= MOST_NAMES else f"{shown} and {len(names) - MOST_NAMES} more"


def _rendered(bpy: Any, scene: Any, depsgraph: Any) -> Iterator[tuple[Any, Any]]:
    """Yields the objects that a render shows, each with its evaluated object. Instances and results
    of geometry nodes are included."""
    depsgraph = depsgraph or bpy.context.evaluated_depsgraph_get()
    visited: set[tuple[str, str]] = set()
    for instance in depsgraph.object_instances:
        shown = instance.object
        # The result of geometry nodes is an instance whose type may differ from its object's type.
        held = (instance.parent if instance.is_instance and shown.original.name not in scene.objects else shown).original
        key = (held.name, shown.name + shown.type)
        if key not in visited and is_rendered(held):
            visited.add(key)
            yield held, shown
    there = {name for name, _ in visited}
    # Add objects that the viewport hides and a render shows.
    for held in scene.objects:
        if held.name not in there and is_rendered(held):
            yield held, held


def _is_hair(modifier: Any) -> bool:
    if modifier.type != "PARTICLE_SYSTEM":
        return False
    settings = modifier.particle_system.settings
    return settings.render_type == "PATH" and settings.count > 0


def _is_smoke(modifier: Any) -> bool:
    settings = getattr(modifier, "domain_settings", None) if modifier.type == "FLUID" else None
    return settings is not None and modifier.fluid_type == "DOMAIN" and settings.domain_type == "GAS"


def _materials(shown: Any) -> Iterable[Any]:
    slots = [slot.material for slot in shown.material_slots]
    # Geometry nodes may set other materials.
    slots += list(getattr(shown.data, "materials", None) or ())
    return [material for material in dict.fromkeys(slots) if material is not None]


def _output(material: Any) -> Any:
    """Returns the output node that Cycles uses; None for a material without nodes."""
    tree = material.node_tree
    # Later versions of Blender use the nodes of every material, and `use_nodes` may be missing.
    if tree is None or not getattr(material, "use_nodes", True):
        return None
    return tree.get_output_node("CYCLES") or tree.get_output_node("ALL")


def _reasons(output: Any) -> Iterator[str]:
    """Yields the names of the nodes and settings that an output depends on and the exporter does not
    support."""
    if output.inputs["Displacement"].is_linked:
        yield "displacement"
    nodes = list(_behind(output.inputs["Surface"], ()))
    kinds = {node.type for node, _ in nodes}
    # A node Light Path without a BSDF is the usual way to make a surface that ignores light, which
    # the exporter supports. So the shaders that the material mixes are not reported.
    shadeless = "LIGHT_PATH" in kinds and not any(kind.startswith("BSDF") and kind != "BSDF_TRANSPARENT" for kind in kinds)
    for node, socket in nodes:
        if node.type in MIXED_SHADERS and shadeless:
            continue
        reason = _reason(node, socket)
        if reason:
            yield reason


def _reason(node: Any, socket: Any) -> str | None:
    kind = node.type
    if kind == "TEX_IMAGE" and node.projection != "FLAT":
        return f"{node.bl_label} with {node.projection.lower()} projection"
    if kind == "TEX_COORD" and socket.name != "UV":
        return f"{socket.name} coordinates"
    if kind == "NORMAL_MAP" and node.space != "TANGENT":
        return f"{node.bl_label} in {node.space.lower().replace('_', ' ')} space"
    if kind == "ATTRIBUTE" and node.attribute_type != "GEOMETRY":
        return node.bl_label
    if kind == "MATH":
        return None if node.operation in FOLLOWED_MATH else f"Math {node.operation.lower().replace('_', ' ')}"
    if kind in ("MIX", "MIX_RGB"):
        return None if _is_factor(node) else "Mix"
    return None if kind in FOLLOWED else node.bl_label


def _is_factor(node: Any) -> bool:
    """Returns true if a mix is a product that glTF supports: a picture times a constant or vertex
    colours."""
    if node.blend_type != "MULTIPLY" or getattr(node, "data_type", "RGBA") != "RGBA":
        return False
    linked = [socket for socket in node.inputs if socket.enabled and socket.is_linked]
    if any(socket.type == "VALUE" for socket in linked):
        return False
    plain = [socket for socket in linked if socket.links[0].from_node.type not in ("VERTEX_COLOR", "ATTRIBUTE")]
    return len(plain) <= 1


def _behind(socket: Any, groups: tuple[Any, ...]) -> Iterator[tuple[Any, Any]]:
    """Returns all nodes that a socket depends on, each with its used output. Nodes inside of groups
    are included."""
    todo, visited = [(socket, groups)], set()
    while todo:
        socket, groups = todo.pop()
        for link in socket.links:
            node, output = link.from_node, link.from_socket
            key = (tuple(group.name for group in groups), node.name, output.identifier)
            if key in visited or link.is_muted:
                continue
            visited.add(key)
            if node.mute:
                # A muted node returns one of its inputs unchanged, so follow all inputs.
                todo += [(each, groups) for each in node.inputs]
                continue
            if node.type == "GROUP" and node.node_tree is not None and len(groups) < 16:
                for inner in node.node_tree.nodes:
                    if inner.type == "GROUP_OUTPUT" and inner.is_active_output:
                        todo += [(each, (*groups, node)) for each in inner.inputs if each.identifier == output.identifier]
                continue
            if node.type == "GROUP_INPUT":
                if groups:
                    todo += [(each, groups[:-1]) for each in groups[-1].inputs if each.identifier == output.identifier]
                continue
            yield node, output
            todo += [(each, groups) for each in node.inputs if each.enabled]
