"""Tests, without Blender, the code that the Blender extension and the export of .blend files share:
cameras, cached views, outlines, forms of parameters, .glb files."""

from __future__ import annotations

import gc
import json
import math
import os
import random
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy
import pytest

import lumistack
from lumistack.blender import between, command_line, depth, forms, outline
from lumistack.blender.cameras import Window, WindowError, seen_at_mm, view_camera, window_distance, window_of_camera, window_of_job
from lumistack.blender.glb import Glb, radiance_hdr
from lumistack.blender.handover import ball, panel, surface
from lumistack.blender.live import KEPT, Attached, Files, Live, Program, State, toml_of
from lumistack.blender.views import Views, key_of
from lumistack.blender.work import Work


def random_window(chance: random.Random) -> Window:
    axes, _ = numpy.linalg.qr([[chance.gauss(0, 1) for _ in range(3)] for _ in range(3)])
    right, up = (tuple(float(part) for part in axes[:, column]) for column in (0, 1))
    back = tuple(float(part) for part in numpy.cross(right, up))
    centre = (chance.uniform(-5, 5), chance.uniform(-5, 5), chance.uniform(-5, 5))
    return Window(centre, right, up, back, chance.uniform(1e-3, 0.1), (chance.uniform(50, 500), chance.uniform(50, 400)))  # type: ignore[arg-type]


@pytest.mark.parametrize("distance_mm", [None, 600.0, 200.0])
def test_a_view_sees_what_lies_on_its_rays(distance_mm: float | None) -> None:
    """A camera shows each point where the ray of its view hits the window. The expected rays are
    computed independently: (x, y, 0) + z (s, 1), or rays through an eye."""
    chance = random.Random(1)
    for _ in range(200):
        window = random_window(chance)
        slope = (chance.uniform(-0.3, 0.3), chance.uniform(-0.3, 0.3))
        place = (chance.uniform(-80, 80), chance.uniform(-80, 80), chance.uniform(-150, 100))
        camera = view_camera(window, slope, distance_mm, (-200.0, 120.0))
        x, y, z = place
        if distance_mm is None:
            expected = (x - z * slope[0], y - z * slope[1])
        else:
            eye = (distance_mm * slope[0], distance_mm * slope[1], distance_mm)
            share = distance_mm / (distance_mm - z)
            expected = (eye[0] + share * (x - eye[0]), eye[1] + share * (y - eye[1]))
        assert seen_at_mm(camera, window, window.point(place)) == pytest.approx(expected, abs=1e-6)
        back = window.place_mm(window.point(place))
        assert back == pytest.approx(place, abs=1e-9)
        # The point lies between the camera's clipping planes.
        columns = numpy.array(camera.matrix)
        inner = numpy.linalg.solve(columns[:3, :3], numpy.array(window.point(place)) - columns[:3, 3])
        assert -camera.clip_end < inner[2] < -camera.clip_start


def test_views_beyond_what_cameras_can_are_refused() -> None:
    window = random_window(random.Random(2))
    with pytest.raises(WindowError, match="shift of the camera: expected at most 10"):
        view_camera(window, (30.0, 0.0), 600.0, (-1.0, 1.0))
    with pytest.raises(WindowError, match="distance_mm"):
        view_camera(window, (0.0, 0.0), -1.0, (-1.0, 1.0))


def test_the_window_is_the_camera_frustum_at_its_focus() -> None:
    frame = [(0.6, 0.3, -1.0), (0.6, -0.3, -1.0), (-0.4, -0.3, -1.0), (-0.4, 0.3, -1.0)]
    # The camera is rotated by 90 degrees about z. It is also scaled by 2, which has no effect.
    matrix = [[0.0, -2.0, 0.0, 1.0], [2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 2.0, 5.0], [0.0, 0.0, 0.0, 1.0]]
    window = window_of_camera(matrix, frame, False, 4.0, (400.0, 250.0))
    assert window.scale * 400.0 == pytest.approx(4.0)
    # At focus distance 4, the centre of the shifted frame is 4 * 0.1 to the camera's right, which
    # is the scene's +y.
    assert window.centre == pytest.approx((1.0, 0.4, 1.0))
    flat = window_of_camera(matrix, frame, True, 4.0, (400.0, 250.0))
    assert flat.scale * 400.0 == pytest.approx(1.0)
    for focus in (0.0, -1.0, math.nan):
        with pytest.raises(WindowError):
            window_of_camera(matrix, frame, False, focus, (400.0, 250.0))
    job = window.as_job()
    again = window_of_job(job, (400.0, 250.0))
    for name in ("centre", "right", "up", "back"):
        assert getattr(again, name) == pytest.approx(getattr(window, name))


def test_the_window_of_a_camera_without_focus_is_at_the_subject() -> None:
    # A subject at 3 m covers a tenth to all of the picture, and a backdrop is at 300 m.
    for near in (17, 60, 165):
        subject = [2.8 + 0.4 * number / near for number in range(near)]
        found = window_distance(subject + [300.0] * (165 - near))
        assert found is not None and 2.8 < found < 4.0, found
    assert window_distance([2.0 + 2.0 * number / 100 for number in range(101)]) == pytest.approx(3.0), "the middle"
    # A blade of grass in front of the lens has no effect, and neither has content behind an
    # orthographic camera.
    assert window_distance([0.05, *[4.0] * 120, -7.0]) == pytest.approx(4.0)
    assert window_distance([]) is None and window_distance([-1.0]) is None


def test_a_window_is_scaled_and_moved_in_its_plane() -> None:
    chance = random.Random(4)
    for _ in range(50):
        window = random_window(chance)
        size, shift = chance.uniform(0.2, 3.0), (chance.uniform(-1, 1), chance.uniform(-1, 1))
        moved = window.resized(size, shift)
        width = window.size_mm[0]
        # Scale and shift map the upper right corner of the original window to the upper right
        # corner of the new window.
        x, y = 0.5 * size * width + shift[0] * width, 0.5 * size * window.size_mm[1] + shift[1] * width
        assert moved.point((width / 2, window.size_mm[1] / 2, 0.0)) == pytest.approx(window.point((x, y, 0.0)))
        cage = numpy.array(outline.cage(size, shift, 7.0)).reshape(4, 4).T
        assert cage @ [0.5, 0.5, 0.0, 1.0] == pytest.approx([0.5 * size + 7.0 * shift[0], 0.5 * size + 7.0 * shift[1], 0.0, 1.0])
        found, place = outline.of_cage(outline.cage(size, shift, 7.0), 7.0)
        assert found == pytest.approx(size) and place == pytest.approx(shift)


def test_kept_views_are_not_rendered_again(tmp_path: Path) -> None:
    folder = tmp_path / "Ansichten ü"
    views = Views(folder, 3, 3, key_of({"size": [64, 40]}))
    for view in views.missing()[:4]:
        views.begin(view).write_bytes(b"whole")
        views.keep(view)
    # The run is killed while it writes the fifth view.
    views.begin((1, 1)).write_bytes(b"ha")
    again = Views(folder, 3, 3, key_of({"size": [64, 40]}))
    assert again.missing() == [(1, 1), (1, 2), (2, 0), (2, 1), (2, 2)]
    assert not again.begin((1, 1)).exists()
    with pytest.raises(FileNotFoundError):
        again.keep((1, 1))
    assert len(Views(folder, 3, 3, key_of({"size": [64, 41]})).missing()) == 9


def test_work_reports_stops_and_keeps_its_error() -> None:
    started = threading.Event()

    def forever(report: object) -> None:
        assert callable(report)
        while True:
            report("waiting", 0.5)
            started.set()
            time.sleep(0.005)

    work = Work(forever).start()
    assert started.wait(5.0) and work.progress == ("waiting", 0.5) and not work.is_done()
    work.stop()
    assert work.wait(5.0) and work.was_stopped()
    assert Work(lambda _: 7).start().wait(5.0)
    failed = Work(lambda _: 1 / 0).start()
    failed.wait(5.0)
    assert isinstance(failed.error, ZeroDivisionError) and not failed.was_stopped()


def test_a_stopped_factorization_ends(slow: tuple[lumistack.LightField, lumistack.Display]) -> None:
    field, display = slow
    work = Work(lambda report: lumistack.factorize(field, display, iterations=10000, callback=report)).start()
    while work.progress[0] == "" and not work.is_done():
        time.sleep(0.01)
    work.stop()
    assert work.wait(20.0) and work.was_stopped()


def test_outlines() -> None:
    size, eye = (400.0, 250.0), 600.0
    assert len(outline.frame(size)) == 4
    box = outline.depth_box(size, (-60.0, 60.0), eye)
    assert len(box) == 12
    # For an eye at a distance, the edges of the box lie on lines through the eye.
    for (x, y, z) in (end for line in box for end in line):
        assert abs(x) == pytest.approx(200.0 * (eye - z) / eye) and abs(y) == pytest.approx(125.0 * (eye - z) / eye)
    assert outline.depth_box(size, None, None) == []
    deep = outline.depth_box(size, (-math.inf, math.inf), eye)
    assert all(math.isfinite(part) for line in deep for end in line for part in end)
    far = max(abs(end[0]) for line in outline.cone(size, (90.0, 60.0)) for end in line)
    assert far == pytest.approx(200.0 + 0.9 * 400.0)
    assert outline.slope_of_mouse((50, 100), (100, 100), (90.0, 40.0)) == pytest.approx((0.0, math.tan(math.radians(20))))
    assert outline.slope_of_mouse((-9, 0), (100, 100), (90.0, 40.0))[0] == pytest.approx(-1.0)
    assert outline.in_cone((0.0, 0.0, 100.0), (20.0, 20.0)) and not outline.in_cone((50.0, 0.0, 100.0), (20.0, 20.0))
    assert not outline.is_in_front((0.0, 0.0, 1.0), size)


@pytest.mark.parametrize("distance_mm", [None, 500.0])
def test_fitted_depths_lie_in_the_range(distance_mm: float | None) -> None:
    chance = random.Random(3)
    depths = [chance.uniform(-300.0, -100.0) for _ in range(500)]
    assert "100 % of the visible surfaces" in (depth.sentence(depths, (-60.0, 60.0)) or "")
    moved = depth.best_fit(depths, (-150.0, 150.0), distance_mm, compress=False)
    shown = [depth.shown_at(z, moved, distance_mm) for z in depths]
    assert moved.depth_scale == 1.0 and depth.outside(shown, (-150.0, 150.0)) == 0.0
    fit = depth.best_fit(depths, (-20.0, 20.0), distance_mm, compress=True)
    shown = [depth.shown_at(z, fit, distance_mm) for z in depths]
    assert 0.01 < fit.depth_scale < 0.4
    assert depth.outside(shown, (-20.0, 20.0)) <= 0.05
    # The fit does not compress depth more than necessary: some content reaches nearly an end of the
    # range of ±20 mm.
    assert max(map(abs, shown)) > 19.0
    # The drawn box of sharp depths ends at the depths that appear at -20 and 20 mm after the fit.
    low, high = depth.in_scene((-20.0, 20.0), fit.depth_scale, distance_mm) or (0.0, 0.0)
    unmoved = depth.Fit(0.0, fit.depth_scale)
    assert depth.shown_at(high, unmoved, distance_mm) == pytest.approx(20.0)
    if math.isfinite(low):
        assert depth.shown_at(low, unmoved, distance_mm) == pytest.approx(-20.0)
    else:
        assert depth.shown_at(-1e9, unmoved, distance_mm) > -20.0
    open_end = depth.in_scene((-math.inf, 20.0), 0.5, distance_mm)
    assert open_end is not None and open_end[0] == -math.inf
    assert open_end[1] == pytest.approx(40.0 if distance_mm is None else 38.4615, rel=1e-4)
    assert depth.in_scene(None, 0.5, distance_mm) is None
    assert depth.best_fit([], (-1.0, 1.0), distance_mm, True) == depth.Fit(0.0, 1.0)
    assert depth.sentence([], (-1.0, 1.0)) is None and "no depth" in (depth.sentence([1.0], None) or "")


def test_every_parameter_of_every_output_plugin_becomes_a_property() -> None:
    outputs = [plugin for plugin in lumistack.plugins() if plugin["kind"] == "output" and not plugin["presents"]]
    names = [each.identifier for plugin in outputs for each in forms.fields_of(plugin)]
    assert len(outputs) >= 4 and len(names) > 20 and len(set(names)) == len(names)
    for plugin in outputs:
        fields = forms.fields_of(plugin)
        values = {each.identifier: each.default for each in fields}
        assert forms.given(fields, values) == {}
        for each in fields:
            assert each.kind in ("bool", "int", "float", "choice", "text", "file") and each.identifier.isidentifier()
            if each.kind == "choice":
                assert each.default in [value for value, _ in each.options]
    numbers = forms.fields_of({"id": "p", "params": [{"name": "a b", "kind": "int", "default": 3, "min": -(2**60), "max": 2**60, "help": "x."}]})
    assert numbers[0].most == 2**31 - 1 and numbers[0].identifier == "p_a_b"
    assert forms.given(numbers, {"p_a_b": 4}) == {"a b": 4}


def test_labels_are_words_of_artists() -> None:
    outputs = [plugin for plugin in lumistack.plugins() if plugin["kind"] == "output" and not plugin["presents"]]
    labels = {each.name: each.label for plugin in outputs for each in forms.fields_of(plugin)}
    expected = {"png8": "PNG, 8 bits", "exr_depth": "OpenEXR precision", "dpi": "DPI", "camera_distance_mm": "Camera distance (mm)", "bits": "Bits", "animation_rate": "Animation rate (Hz)"}
    assert expected.items() <= labels.items(), labels
    assert labels["lens_rotation_deg"] == "Lens rotation (°)" and forms.label("a4") == "A4" and forms.label("blue_noise") == "Blue noise"
    # A unit stands at most once in a label, and no abbreviation is written like a word.
    for text in labels.values():
        assert not any(word in ("Dpi", "Exr", "Png8", "Hci", "mm", "deg") for word in text.split()), text


def test_directions_for_the_score_lie_between_the_views() -> None:
    views = [0.1 * (number - 6) for number in range(13)]
    assert between.directions(views, 4) == pytest.approx([-0.45, -0.15, 0.15, 0.45])
    assert between.directions(views, 2, 0.7) == pytest.approx([-0.35, 0.35])
    assert between.directions([0.2], 4) == [0.2]
    for count in range(2, 30):
        views = [0.1 * (number - (count - 1) / 2) for number in range(count)][:: 1 if count % 3 else -1]
        for most, reach in ((1, 1.0), (2, 0.7), (4, 1.0), (5, 0.5)):
            found = between.directions(views, most, reach)
            assert 1 <= len(found) <= most and len(found) >= min(2, most, count - 1)
            assert found == pytest.approx([-slope for slope in found[::-1]]) or most == 1
            assert all(min(abs(slope - view) for view in views) == pytest.approx(0.05) for slope in found)
    # The picture after a run is seen from the slope between two views that is nearest to straight
    # ahead. If two slopes are equally near, it is the one to the right or up.
    assert between.beside_middle([-0.1, 0.0, 0.1]) == pytest.approx(0.05) == between.beside_middle([0.1, 0.0, -0.1])
    assert between.beside_middle([-0.15, -0.05, 0.05, 0.15]) == pytest.approx(0.0) and between.beside_middle([0.0]) == 0.0


def test_the_score_of_two_noisy_renders_has_no_noise() -> None:
    """The true squared error is 0.01. The renders' noise has the variance 0.02."""
    noise = numpy.random.default_rng(5)
    seen, truth = 0.1, [noise.normal(0.0, 0.02**0.5, 400_000) for _ in range(2)]
    pictures = [*truth, (truth[0] + truth[1]) / 2.0]
    errors = [float(numpy.mean((seen - picture) ** 2)) for picture in pictures]
    found = [{"directions": [((0.0, 0.0), -10.0 * math.log10(error))]} for error in errors]
    # The mean product has a standard deviation of 0.00005. The tolerance is more than 6 of them.
    assert between.score(found).psnr_zone == pytest.approx(20.0, abs=0.15)
    assert between.score(found[:1]).psnr_zone < 16.0
    both = between.score([{"directions": [((0.0, 0.0), 20.0), ((0.1, 0.0), 30.0)]}])
    assert both.psnr_zone == pytest.approx(-10 * math.log10((0.01 + 0.001) / 2)) and both.worst == pytest.approx(20.0) and both.directions == 2
    assert "worst of 2 directions 20.0 dB" in both.text() and between.UNKNOWN.text() == "not scored between the views"
    assert between.score([{"directions": [((0.0, 0.0), math.inf)]}]).psnr_zone == math.inf


def test_a_far_backdrop_does_not_flatten_the_scene() -> None:
    chance = random.Random(8)
    subject = [chance.uniform(-200.0, 100.0) for _ in range(600)]
    backdrop = [chance.uniform(-60_000.0, -50_000.0) for _ in range(400)]
    for distance_mm in (None, 800.0):
        fit = depth.best_fit(subject + backdrop, (-80.0, 80.0), distance_mm, compress=True)
        alone = depth.best_fit(subject, (-80.0, 80.0), distance_mm, compress=True)
        shown = [depth.shown_at(z, fit, distance_mm) for z in subject]
        assert depth.outside(shown, (-80.0, 80.0)) < 0.1 and fit.depth_scale >= depth.LEAST_SCALE
        if distance_mm is None:
            # For parallel views a far backdrop has unbounded parallax.
            assert fit.depth_scale > 0.8 * alone.depth_scale
        assert depth.better_fit(subject + backdrop, (-80.0, 80.0), distance_mm, True, depth.Fit(0.0, 1.0)) == fit
        assert depth.better_fit(subject + backdrop, (-80.0, 80.0), distance_mm, True, fit) is None
    # Two far clusters: no movement helps the one without blurring the other, so nothing changes.
    halves = [-5.0] * 500 + [-9000.0] * 500
    assert depth.better_fit(halves, (-10.0, 10.0), None, False, depth.Fit(0.0, 1.0)) is None
    assert depth.better_fit([1.0, 2.0], (-10.0, 10.0), None, True, depth.Fit(0.0, 1.0)) is None


def test_depths_are_in_front_or_behind() -> None:
    assert depth.place(-94.2) == "94 mm behind" and depth.place(60.0) == "60 mm in front of" and depth.place(-math.inf) == "far behind"
    # A fit brings content to the ends of the range. Single precision may move this content slightly
    # out of the range.
    assert depth.outside([-80.00001, 80.00001], (-80.0, 80.0)) == 0.0 and depth.outside([-82.0, 82.0, 0.0, 1.0], (-80.0, 80.0)) == 0.5
    assert depth.outside([-1e9, 3.0], (-math.inf, 4.0)) == 0.0
    text = depth.sentence([-300.0, 40.0], (-80.0, 80.0)) or ""
    assert "from 300 mm behind to 40 mm in front of the display, but the display is sharp only from 80 mm behind to 80 mm in front of its plane" in text
    assert depth.moved(depth.Fit(-94.0, 0.5)) == "The window moved forward by 94 mm; depth is shown at 50 %"
    assert depth.moved(depth.Fit(12.0, 1.0)) == "The window moved back by 12 mm; the depth is unchanged"
    assert depth.moved(depth.Fit(-0.2, 0.5)).startswith("The window stays in place")


def test_triangles_without_area_are_dropped(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    file = Glb.empty()
    place = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    # Two triangles have an area, one of them a tiny one. The others have two equal corners, or
    # three corners on a line.
    positions = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (2.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (0.0, 1e-9, 0.0)]
    triangles = [(0, 1, 2), (0, 0, 1), (0, 1, 3), (0, 4, 5)]
    file.add_glow("text", place, positions, triangles, (1.0, 1.0, 1.0))
    file.write(tmp_path / "flat.glb")
    with pytest.warns(lumistack.LumistackWarning, match="triangles without area, which are left out: 2 of 4"):
        lumistack.Scene(tmp_path / "flat.glb")
    assert file.drop_flat_triangles() == 2 and file.drop_flat_triangles() == 0
    file.write(tmp_path / "clean.glb")
    recwarn.clear()
    assert lumistack.Scene(tmp_path / "clean.glb").triangles == 2 and not recwarn.list


def test_what_is_added_to_a_glb_is_what_the_reader_finds(tmp_path: Path) -> None:
    file = Glb.empty()
    turned = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
    positions, triangles = panel(2.0, 1.0, False)
    file.add_glow("Lampe ß", turned, positions, triangles, (4.0, 2.0, 1.0))
    file.add_glow("ball", turned, *ball(0.5), (1.0, 1.0, 1.0))
    file.add_light("sun", turned, {"type": "directional", "intensity": 2.0})
    file.add_camera("first", turned, {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}, 2.5)
    file.add_camera("second", turned, {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0, "zfar": 9}}, None)
    file.set_environment(8, 4, [(0.25, 0.5, 1.0)] * 32)
    path = tmp_path / "szene ü.glb"
    file.write(path)
    again = Glb.read(path)
    assert again.document["meshes"] == file.document["meshes"] and bytes(again.binary)[: len(file.binary)] == bytes(file.binary)
    scene = lumistack.Scene(path)
    assert scene.cameras == ["first", "second"]
    assert scene.triangles == 2 + len(ball(0.5)[1])
    (x0, y0, z0), (x1, y1, z1) = scene.bounds
    assert (x0, x1) == pytest.approx((0.0, 2.0)) and (z0, z1) == pytest.approx((2.5, 3.5), abs=0.02)
    assert json.loads(json.dumps(again.scene["extras"]))["lumistack"]["environment"]["strength"] == 1.0
    with pytest.raises(ValueError, match="expected a .glb"):
        (tmp_path / "no.glb").write_bytes(b"nothing of the kind, but long enough")
        Glb.read(tmp_path / "no.glb")


def test_light_shapes_have_their_true_area() -> None:
    assert surface(*ball(0.3)) == pytest.approx(4 * math.pi * 0.09)
    assert surface(*panel(2.0, 3.0, False)) == pytest.approx(6.0)
    assert surface(*panel(2.0, 3.0, True)) == pytest.approx(math.pi * 1.5)
    for positions, triangles in (ball(1.0), panel(1.0, 1.0, True), panel(1.0, 1.0, False)):
        for a, b, c in triangles:
            p = numpy.array(positions)
            normal = numpy.cross(p[b] - p[a], p[c] - p[a])
            outwards = p[a] + p[b] + p[c] if len(positions) > 30 and p[:, 2].any() else numpy.array([0.0, 0.0, -1.0])
            assert normal @ outwards > 0.0


def test_shared_exponents_keep_eight_bits() -> None:
    chance = random.Random(4)
    for _ in range(300):
        rgb = [2.0 ** chance.uniform(-20, 20) * chance.random() for _ in range(3)]
        code = radiance_hdr(1, 1, [rgb])[-4:]
        back = [value / 256 * 2.0 ** (code[3] - 128) for value in code[:3]]
        assert back == pytest.approx(rgb, abs=max(rgb) / 250)
    assert radiance_hdr(1, 1, [(0.0, 0.0, 0.0)])[-4:] == b"\0\0\0\0"


def test_words_become_settings() -> None:
    asked = command_line.parse(["make", "-o", "out", "--display", "mine.toml", "--views", "3x2", "--pixels", "10", "--frames", "2..5", "--window-distance", "3"])
    assert asked.settings["file"] == "mine.toml" and asked.settings["display_from"] == "FILE"
    assert asked.settings["views"] == (3, 2) and asked.settings["views_from"] == "OWN" and asked.settings["quality"] == "CUSTOM"
    assert asked.settings["window_from"] == "DISTANCE" and asked.scene_settings == {"frame_start": 2, "frame_end": 5}
    asked = command_line.parse(["--window-size", "0.5", "--handover", "both", "--renderer", "lumistack"])
    assert asked.settings == {"window_size": 0.5, "handover": "BOTH", "renderer": "LUMISTACK"}
    assert command_line.parse(["--quality", "draft", "--views", "half", "--no-score"]).settings == {"quality": "DRAFT", "views_from": "HALF", "use_score": False}
    # --distance-mm is the viewer's distance from the display. Only the perspective grid has this
    # distance, so the option selects that grid.
    for words in (["--distance-mm", "500"], ["--distance-mm", "500", "--grid", "perspective"]):
        assert command_line.parse(words).settings == {"distance_mm": 500.0, "grid": "PERSPECTIVE"}
    for grid in ("oblique", "display"):
        with pytest.raises(command_line.Usage, match=f"--distance-mm: expected --grid perspective, .* found --grid {grid}") as caught:
            command_line.parse(["--distance-mm", "500", "--grid", grid])
        assert caught.value.code == 2
    assert command_line.parse([]).settings == {} and command_line.parse([]).what == "make"
    for words in (["bake"], ["--views", "3"], ["--quality", "draft", "--samples", "2"], ["--frames", "5..2"], ["--unknown"]):
        with pytest.raises(command_line.Usage) as caught:
            command_line.parse(words)
        assert caught.value.code == 2
    with pytest.raises(command_line.Usage) as caught:
        command_line.parse(["--help"])
    assert caught.value.code == 0 and "--display" in str(caught.value)


def test_jobs_become_toml() -> None:
    job = {"name": 'a "b" \\ ü \n \x7f', "scene": "C:\\ä.glb", "window": {"from": "given", "centre": [0.0, -1.5, 2e-9], "width": 3}, "light": {"automatic": False}}
    assert tomllib.loads(toml_of(job)) == job


def test_only_the_last_files_of_a_scene_stay(tmp_path: Path) -> None:
    folder = tmp_path / "ü"
    for _ in range(2):
        files = Files(folder, "scene", ".glb")
        made = []
        for number in range(KEPT + 3):
            made.append(files.next())
            made[-1].write_text(str(number))
            # After `back` the next file gets the number of the removed file.
            files.next().write_text("the same")
            files.back()
        assert len(set(made)) == KEPT + 3
        assert sorted(folder.iterdir()) == made[-KEPT:]
    # A new session names no file that a running program may read.
    assert Files(folder, "scene", ".glb").next() not in made


def live_words(tmp_path: Path) -> list[str]:
    field = tmp_path / "field.npy"
    numpy.save(field, numpy.full((3, 3, 16, 24, 3), 0.4, numpy.float32))
    job = {"name": "plain", "light_field": str(field), "geometry": {"fov_deg": [20, 20], "pitch_mm": 3.0}, "display": {"preset": "fig7-uniform", "frames": 2}}
    (tmp_path / "job.toml").write_text(toml_of(job), encoding="utf-8")
    return [sys.executable, "-m", "lumistack", "--json", "live", "--no-open", str(tmp_path / "job.toml"), "-o", str(tmp_path / "run")]


def until(live: Program, is_right: Callable[[State], bool]) -> State:
    for _ in range(6000):
        if is_right(live.state):
            return live.state
        time.sleep(0.01)
    raise AssertionError(f"expected another state, found {live.state}")


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_a_live_display_follows_changes_and_ends_with_its_folder(tmp_path: Path) -> None:
    live = Live(live_words(tmp_path), os.environ)
    first = until(live, lambda state: state.content == 1)
    assert first.latency_s is None and first.code is None
    begin = time.monotonic()
    live.change({"display.brightness": 0.3}, begin - 1.0)
    assert not live.is_shown
    changed = until(live, lambda state: state.content == 2)
    assert live.is_shown and changed.latency_s is not None and 1.0 < changed.latency_s <= time.monotonic() - begin + 1.0
    live.change({"display.bright": 0.3}, time.monotonic())
    refused = until(live, lambda state: state.problem != "")
    assert "did you mean `brightness`?" in refused.problem and live.is_shown and refused.content == 2
    # The next change clears the message about the refused change.
    live.change({"display.brightness": 0.4}, time.monotonic())
    assert until(live, lambda state: state.content == 3).problem == ""
    assert until(live, lambda state: state.address != "").address.startswith("http://localhost:")
    live.stop()
    ended = until(live, lambda state: state.code is not None)
    assert ended.code == 0 and Path(ended.report).is_file()
    # Changes after the end have no effect, and the streams are destroyed without an error.
    live.change({"display.brightness": 0.5}, time.monotonic())
    live.change({"display.brightness": 0.6}, time.monotonic())
    del live
    gc.collect()


def test_a_live_display_that_does_not_start_says_why(tmp_path: Path) -> None:
    words = live_words(tmp_path)
    (tmp_path / "field.npy").unlink()
    ended = until(Live(words, os.environ), lambda state: state.code is not None)
    assert ended.code and "field.npy" in ended.problem, ended


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_live_display_ends_with_the_program_that_started_it(tmp_path: Path) -> None:
    text = (
        "import os, signal, sys, time; from lumistack.blender.live import Live; live = Live(sys.argv[1:], os.environ)\n"
        "while live.state.states == 0: time.sleep(0.01)\n"
        "assert live.state.code is None; os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", text, *live_words(tmp_path)], capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done
    # The live display of the killed caller locks the run folder. New displays can start only after
    # it has ended, so try for a while.
    for _ in range(60):
        live = Live(live_words(tmp_path), os.environ)
        if until(live, lambda state: state.states > 0 or state.code is not None).code is None:
            live.end(60.0)
            return
        time.sleep(1.0)
    raise AssertionError("the live display still runs after its caller was killed")


def test_a_program_attaches_to_a_live_display_and_leaves_it_running(tmp_path: Path) -> None:
    run = tmp_path / "run"
    with pytest.raises(FileNotFoundError, match=r"run: expected the run folder of a `lumistack live` that runs, found a folder without the file cache"):
        Attached(run)
    live = Live(live_words(tmp_path), os.environ)
    until(live, lambda state: state.address != "")
    attached = Attached(run)
    first = until(attached, lambda state: state.content == 1)
    assert first.address == live.state.address and first.code is None
    with pytest.raises(OSError, match="a program is attached already"):
        Attached(run)
    attached.change({"display.brightness": 0.3}, time.monotonic())
    assert until(attached, lambda state: state.content == 2).latency_s is not None and attached.is_shown
    attached.change({"display.bright": 0.3}, time.monotonic())
    assert "did you mean `brightness`?" in until(attached, lambda state: state.problem != "").problem
    attached.end(10.0)
    assert attached.state.code == 0 and live.state.code is None
    again = Attached(run)
    assert until(again, lambda state: state.content > 0).content == 2
    door = run / "cache" / "live.json"
    kept = door.read_text()
    live.stop()
    ended = until(again, lambda state: state.code is not None)
    assert ended.code == 0 and Path(ended.report).is_file()
    until(live, lambda state: state.code is not None)
    # A killed program does not remove its file live.json.
    door.write_text(kept)
    with pytest.raises(OSError, match="found the folder of a program that has ended"):
        Attached(run)
