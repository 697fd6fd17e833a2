# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads rendered views from files, and on request applies the scene's colour management to them.
Also shows simulated views in Blender's image editor."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy

#: Name of the image with the simulated view.
SHOWN = "Lumistack"
#: Name of images that exist only during a conversion.
TEMPORARY = "Lumistack conversion"


def load(path: Path, linear: bool = True) -> numpy.ndarray:
    """Returns the values of a picture file as [row, column, rgb], the top row first. If `linear` is
    false, the values are those in the file, without a conversion to linear light."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        if not linear:
            image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        if width * height == 0:
            raise ValueError(f"{path}: expected a picture, found a damaged file; remove the file and render again")
        values = numpy.empty(width * height * image.channels, dtype=numpy.float32)
        image.pixels.foreach_get(values)
        picture = values.reshape(height, width, image.channels)[::-1, :, :3]
        return numpy.ascontiguousarray(picture)
    finally:
        bpy.data.images.remove(image)


def as_shown(picture: Path | numpy.ndarray, scene) -> numpy.ndarray:
    """Returns a picture after the scene's view transform, exposure, look and curves for an sRGB
    screen, converted back to linear light 0..1. The picture is a file, or linear values [row, column,
    rgb], the top row first."""
    settings, display = scene.render.image_settings, scene.display_settings
    old: list[tuple[object, str, object]] = []

    def change(held, name, value):
        if hasattr(held, name):
            old.append((held, name, getattr(held, name)))
            setattr(held, name, value)

    image = bpy.data.images.load(str(picture), check_existing=False) if isinstance(picture, Path) else of_values(TEMPORARY, picture)
    try:
        change(settings, "media_type", "IMAGE")
        change(settings, "file_format", "PNG")
        change(settings, "color_mode", "RGB")
        change(settings, "color_depth", "16")
        # The file is read immediately, so compressing it would only take time.
        change(settings, "compression", 0)
        change(settings, "color_management", "FOLLOW_SCENE")
        if display.display_device != "sRGB":
            change(display, "display_device", "sRGB")
        with tempfile.TemporaryDirectory() as folder:
            shown = Path(folder) / "shown.png"
            image.save_render(str(shown), scene=scene)
            codes = load(shown, linear=False)
    finally:
        for held, name, value in reversed(old):
            setattr(held, name, value)
        bpy.data.images.remove(image)
    return from_srgb(codes)


def from_srgb(codes: numpy.ndarray) -> numpy.ndarray:
    """Converts sRGB codes 0..1 to linear light."""
    linear = numpy.where(codes <= 0.04045, codes / 12.92, ((numpy.maximum(codes, 0.0) + 0.055) / 1.055) ** 2.4)
    return numpy.clip(linear, 0.0, 1.0).astype(numpy.float32)


def show(picture: numpy.ndarray) -> object:
    """Writes a linear picture [row, column, rgb] to the image that image editors show."""
    rows, columns, _ = picture.shape
    image = bpy.data.images.get(SHOWN)
    if image is None or tuple(image.size) != (columns, rows) or not image.is_float:
        if image is not None:
            bpy.data.images.remove(image)
        image = of_values(SHOWN, picture)
    else:
        fill(image, picture)
    return image


def of_values(name: str, picture: numpy.ndarray) -> object:
    """Makes an image of linear values [row, column, rgb], the top row first."""
    rows, columns, _ = picture.shape
    image = bpy.data.images.new(name, columns, rows, alpha=False, float_buffer=True)
    fill(image, picture)
    return image


def fill(image, picture: numpy.ndarray) -> None:
    values = numpy.ones((*picture.shape[:2], 4), numpy.float32)
    values[..., :3] = picture[::-1]
    image.pixels.foreach_set(values.ravel())
    image.update()


def remove() -> None:
    image = bpy.data.images.get(SHOWN)
    if image is not None:
        bpy.data.images.remove(image)
