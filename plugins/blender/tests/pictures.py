# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases that compare pictures: Blender's views with Lumistack's, and the drawings in the 3D view."""

import os
from pathlib import Path

from common import configure, install, run

#: Largest relative difference of the mean radiance of a view between the renderers.
MEAN = 0.02


def hit_masks(field):
    """Returns masks [view, row, column]: true if the shape covers at least half of a pixel."""
    return field.radiance[..., 1].reshape(-1, *field.shape[2:4]) >= 0.5


def grown(mask):
    """Returns the masks, grown by one pixel in all directions, also diagonally."""
    import numpy

    padded = numpy.pad(mask, ((0, 0), (1, 1), (1, 1)))
    rows, columns = mask.shape[1:]
    return numpy.logical_or.reduce([padded[:, y : y + rows, x : x + columns] for y in range(3) for x in range(3)])


def light_fields(scene, folder, grid):
    """Renders the same views by Cycles and by Lumistack's path tracer; returns both light fields."""
    import lumistack

    fields = []
    for renderer in ("BLENDER", "LUMISTACK"):
        out = configure(scene, folder, grid=grid, distance_mm=500.0, renderer=renderer)
        scene.lumistack.folder = str(out / f"{grid} {renderer}")
        job = run(scene, factorize=False)
        assert not [line for line in job.warnings if not line.startswith("depth")], job.warnings
        fields.append(lumistack.LightField.open(Path(scene.lumistack.folder) / "target"))
    return fields


def case_silhouettes(folder, zip_path):
    """In both projections, the outlines of Cycles' views and of Lumistack's views differ by at most
    one pixel."""
    import scenes

    install(zip_path)
    scene = scenes.silhouettes()
    for grid in ("OBLIQUE", "PERSPECTIVE"):
        ours, theirs = light_fields(scene, folder, grid)
        assert ours.shape == theirs.shape == (3, 3, 60, 96, 3)
        assert (ours.distance_mm is None) == (grid == "OBLIQUE")
        beyond = outlines(grid, ours, theirs)
        assert sum(beyond) == 0, beyond
    return ""


def outlines(grid, ours, theirs):
    """Counts, for every view, the pixels that differ although one pixel of tolerance is allowed."""
    a, b = hit_masks(ours), hit_masks(theirs)
    share = a.mean()
    assert 0.1 < share < 0.4, share
    # The outlines of different views differ by more than the tolerance, so the test is not trivial.
    assert (a[0] & ~grown(a)[8]).sum() > 50
    beyond = [int((a[view] & ~grown(b)[view]).sum() + (b[view] & ~grown(a)[view]).sum()) for view in range(9)]
    print(f"{grid}: {int((a != b).sum())} of {a.size} pixels on the outlines differ, {sum(beyond)} by more than one pixel; views {beyond}")
    return beyond


def case_radiance(folder, zip_path):
    """Cycles and Lumistack's path tracer give the same mean radiance of a diffuse scene, in every
    view and channel."""
    import numpy
    import scenes

    install(zip_path)
    scene = scenes.diffuse()
    scene.cycles.samples = 96
    for grid in ("OBLIQUE", "PERSPECTIVE"):
        configure(scene, folder, grid=grid)
        ours, theirs = light_fields_of(scene, folder, grid, samples=96)
        means = [field.radiance.astype(numpy.float64).mean(axis=(2, 3)) for field in (ours, theirs)]
        off = means[1] / means[0] - 1.0
        clipped = float((ours.radiance >= 1.0).mean())
        print(f"{grid}: means {means[0].mean():.4f} and {means[1].mean():.4f}, apart by {100 * abs(off).max():.2f} % at most, {100 * off.mean():+.2f} % in all; {100 * clipped:.2f} % clipped")
        assert clipped < 0.005
        assert abs(off).max() < MEAN, off
    return ""


def light_fields_of(scene, folder, grid, samples):
    import lumistack

    fields = []
    for renderer in ("BLENDER", "LUMISTACK"):
        out = configure(scene, folder, grid=grid, distance_mm=500.0, renderer=renderer, samples=samples, exposure_ev=-1.0)
        scene.lumistack.folder = str(out / f"{grid} {renderer}")
        run(scene, factorize=False)
        fields.append(lumistack.LightField.open(Path(scene.lumistack.folder) / "target"))
    return fields


def case_look(folder, zip_path):
    """Blender's Color Management applies to both renderers, and view transforms give different
    pictures. A text, whose mesh has triangles without area, gives no warning."""
    import bpy
    import numpy
    import scenes

    install(zip_path)
    from bl_ext.user_default.lumistack import jobs

    scene = scenes.diffuse()
    scene.cycles.samples = 64
    configure(scene, folder)
    found = {}
    scene.lumistack.use_score = False
    bpy.ops.object.text_add(location=(-0.4, -1.0, 0.3), rotation=(1.2, 0.0, 0.0))
    bpy.context.object.data.body, bpy.context.object.data.extrude = "TENSOR", 0.03
    bpy.context.object.data.materials.append(bpy.data.materials["clay"])
    for transform, exposure in (("AgX", 1.0), ("Standard", 1.0), ("Standard", 0.0)):
        for renderer in ("BLENDER", "LUMISTACK"):
            out = configure(scene, folder, renderer=renderer, look="SCENE", samples=64, views_from="OWN", views=(1, 1))
            scene.view_settings.view_transform, scene.view_settings.exposure = transform, exposure
            scene.lumistack.folder = str(out / f"{transform} {exposure} {renderer}")
            job = run(scene, factorize=False)
            assert all(line.startswith("depth") for line in job.warnings), job.warnings
            import lumistack

            field = lumistack.LightField.open(jobs.output_folder(scene) / "target")
            found[transform, exposure, renderer] = field.radiance.astype(numpy.float64).mean(axis=(0, 1, 2, 3))
    for (transform, exposure, renderer), theirs in found.items():
        off = found[transform, exposure, "LUMISTACK"] / found[transform, exposure, "BLENDER"] - 1.0
        print(f"note: {transform} {exposure:+.0f} EV: {renderer} {theirs}, apart by {100 * abs(off).max():.2f} %")
        assert abs(off).max() < MEAN, off
    apart = [abs(found["AgX", 1.0, renderer] / found["Standard", 1.0, renderer] - 1.0).max() for renderer in ("BLENDER", "LUMISTACK")]
    assert min(apart) > 0.05, apart
    return ""


def case_exporters(folder, zip_path):
    """A scene gives views of the same mean radiance through Blender's glTF exporter and its USD
    exporter. With both, the job reports their difference."""
    import bpy
    import numpy
    import scenes

    install(zip_path)
    from bl_ext.user_default.lumistack import jobs
    from lumistack.blender import usd

    scene = scenes.diffuse()
    if not bpy.app.build_options.usd:
        return "skipped: this Blender has no USD"
    if not usd.is_readable(bpy) and not os.environ.get("LUMISTACK_PYTHON"):
        return "skipped: this Blender's Python has no OpenUSD, and LUMISTACK_PYTHON names none"
    bpy.data.objects.remove(bpy.data.objects["sun"])
    for shader in bpy.data.materials:
        # UsdPreviewSurface always has a specular reflection, so give one to the materials.
        shader.node_tree.nodes["Principled BSDF"].inputs["Specular IOR Level"].default_value = 0.5

    def both(name, **values):
        fields = []
        for kind in ("GLTF", "USD"):
            out = configure(scene, folder, grid="PERSPECTIVE", distance_mm=500.0, renderer="LUMISTACK", handover=kind, samples=64, exposure_ev=-1.0, **values)
            scene.lumistack.folder = str(out / name / kind)
            run(scene, factorize=False)
            fields.append(lumistack.LightField.open(Path(scene.lumistack.folder) / "target"))
        means = [field.radiance.astype(numpy.float64).mean(axis=(2, 3)) for field in fields]
        print(f"note: {name}: glTF {means[0].mean():.4f}, USD {means[1].mean():.4f}, apart by {100 * abs(means[1] / means[0] - 1.0).max():.2f} % at most")
        return means[1] / means[0]

    import lumistack

    off = both("lamps and world") - 1.0
    assert abs(off).max() < MEAN, off
    assert jobs.renderers_of(scene.lumistack) == ["USD"]
    # Blender's USD exporter writes suns in units of its own: in 5.0 a sun is a quarter as bright.
    # The factor is the same for every sun, so the test measures it.
    for name in ("area", "point"):
        bpy.data.objects.remove(bpy.data.objects[name])
    scenes.background(0.0)
    scenes.lamp("SUN", 2.0, rotation=(0.5, 0.3, 0.0))
    ratio = both("sun")
    assert abs(ratio / ratio.mean() - 1.0).max() < 0.1, ratio
    out = configure(scene, folder, renderer="LUMISTACK", handover="BOTH", samples=4, views_from="OWN", views=(1, 1))
    job = run(scene, factorize=False)
    assert len(job.said) == 1 and "Lumistack's views of the USD file against Lumistack's views of the glTF file" in job.said[0], job.said
    assert (out / "scene.glb").is_file() and (out / "scene.usdc").is_file()
    return f"a sun in USD is {ratio.mean():.3f} times as bright"


def case_eevee(folder, zip_path):
    """In both projections, the outlines of EEVEE's views and of Lumistack's views differ by at most
    one pixel. The case needs OpenGL."""
    import scenes

    install(zip_path)
    from bl_ext.user_default.lumistack import jobs

    scene = scenes.silhouettes()
    scene.render.engine = eevee(scene)
    # A few samples are enough, since only outlines are compared.
    scene.eevee.taa_render_samples = 8
    scene.render.filter_size = 0.0
    for grid in ("OBLIQUE", "PERSPECTIVE"):
        try:
            ours, theirs = light_fields(scene, folder, grid)
        except jobs.JobError as error:
            assert "OpenGL" in str(error), error
            print("note:", error)
            return "skipped: no OpenGL here"
        beyond = outlines(grid, ours, theirs)
        assert sum(beyond) == 0, beyond
    return ""


def eevee(scene):
    names = [each.identifier for each in scene.render.bl_rna.properties["engine"].enum_items]
    return next(name for name in ("BLENDER_EEVEE_NEXT", "BLENDER_EEVEE") if name in names)


def case_overlay(folder, zip_path):
    """The drawings in the 3D view: the window has the edges of the camera's picture, and arrow and
    frame move it. The case also writes a picture of the window from the side."""
    import bpy
    import numpy
    import scenes
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Matrix, Vector

    install(zip_path)
    from bl_ext.user_default.lumistack import operators, overlay

    scene = scenes.diffuse()
    scene.cycles.samples = 8
    # Nothing is drawn in a file that does not use the extension.
    assert not scene.lumistack.is_used and not overlay.is_drawn(scene) and not overlay._outlines
    configure(scene, folder, views_from="OWN", views=(3, 1), look="SCENE", show_cone=True)
    assert scene.lumistack.is_used and overlay.is_drawn(scene)
    display, window = overlay.placement(scene)
    scene.render.resolution_x, scene.render.resolution_y = 960, 600
    for colour, ends in overlay.lines_of(scene):
        if colour == overlay.WINDOW:
            places = [world_to_camera_view(scene, scene.camera, Vector(end)) for end in ends]
            assert {(round(place.x, 3), round(place.y, 3)) for place in places} == {(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)}
            assert all(abs(place.z - 4.0) < 1e-4 for place in places), "the window is not in the plane of focus"
    # The window moves along its normal, and the arrow's origin stays in place.
    origin = overlay.arrow_matrix(window, 0.0).translation.copy()
    scene.lumistack.moved_back_mm = 30.0
    overlay.forget()
    moved = overlay.placement(scene)[1]
    normal = Vector(window.back)
    assert (Vector(moved.centre) - Vector(window.centre) + 30.0 * window.scale * normal).length < 1e-5
    assert (overlay.arrow_matrix(moved, 30.0).translation - origin).length < 1e-5
    # The frame that the user drags has the same corners as the window. Width and height set the
    # window's size.
    held = scene.lumistack
    for grid in ("OBLIQUE", "PERSPECTIVE"):
        held.grid, held.window_size, held.window_shift = grid, 1.3, (0.2, -0.1)
        display, changed = overlay.placement(scene)
        basis, (width, height), unit = overlay.cage_of(display, changed, held)
        offset = Matrix(numpy.array(overlay.outline.cage(held.window_size, held.window_shift, unit)).reshape(4, 4).T.tolist())
        for (line, _), (x, y) in zip(overlay.outline.frame(changed.size_mm), ((-1, 1), (1, 1), (1, -1), (-1, -1))):
            assert (Vector(changed.point(line)) - basis @ offset @ Vector((x * width / 2, y * height / 2, 0.0))).length < 1e-5
        before = held.window_width
        held.window_height = 2.0 * held.window_height
        assert abs(held.window_size - 2.6) < 1e-5 and abs(held.window_width - 2.0 * before) < 1e-5
    held.grid, held.window_size, held.window_shift, held.moved_back_mm = "DISPLAY", 1.0, (0.0, 0.0), 0.0
    overlay.forget()
    run(scene)
    operators.show_view(scene, (0.0, 0.0))
    # Draw the scene with the window from the side, as a 3D view shows it.
    look, side = scene.camera, scenes.camera("side")
    side.data.dof.use_dof = False
    side.location, side.rotation_euler = (4.2, -2.6, 2.0), (1.25, 0.0, 0.98)
    side.data.lens = 30.0
    bpy.context.view_layer.update()
    path = folder / "side.png"
    scene.render.filepath, scene.render.image_settings.file_format = str(path), "PNG"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = numpy.empty(960 * 600 * 4, numpy.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(600, 960, 4)
    drawn = []
    scene.camera = look
    overlay.forget()
    shown = overlay._pictures[scene.name][::-1]
    corners = [Vector(window.point(line[0])) for line in overlay.outline.frame(window.size_mm)]
    for v in numpy.linspace(0.0, 1.0, 500, endpoint=False):
        for u in numpy.linspace(0.0, 1.0, 800, endpoint=False):
            point = corners[3].lerp(corners[2], u).lerp(corners[0].lerp(corners[1], u), v)
            place = world_to_camera_view(scene, side, point)
            row, column = int(place.y * 600), int(place.x * 960)
            if 0 <= row < 600 and 0 <= column < 960:
                linear = shown[int(v * shown.shape[0]), int(u * shown.shape[1])]
                pixels[row, column, :3] = numpy.clip(linear, 0.0, 1.0) ** (1 / 2.2)
    for colour, ends in overlay.lines_of(scene):
        for start, end in zip(ends[::2], ends[1::2]):
            drawn.append(colour)
            for share in numpy.linspace(0.0, 1.0, 1500):
                place = world_to_camera_view(scene, side, Vector(start).lerp(Vector(end), share))
                row, column = int(place.y * 600), int(place.x * 960)
                if place.z > 0.0 and 1 <= row < 599 and 1 <= column < 959:
                    pixels[row : row + 2, column : column + 2, :3] = numpy.array(colour[:3]) ** (1 / 2.2)
    assert len(drawn) == 4 + 12 + 8
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw = str(folder / "overlay.png")
    image.save()
    return str(folder / "overlay.png")
