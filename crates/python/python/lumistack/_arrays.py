"""Light fields as arrays of other libraries."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lumistack._lumistack import LightField


def dlpack(array: Any, **options: Any) -> Any:
    """Returns a DLPack capsule of a read-only NumPy array."""
    try:
        return array.__dlpack__(**options)
    except (BufferError, TypeError):
        # Older versions of NumPy refuse read-only memory, and know no option except `stream`. So
        # export a copy.
        return array.copy().__dlpack__(**{key: value for key, value in options.items() if key == "stream"})


def from_dlpack(tensor: Any, what: str) -> Any:
    """Converts an object that supports no other known protocol to a NumPy array, by DLPack."""
    import numpy

    try:
        return numpy.from_dlpack(tensor)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        found = type(tensor).__name__
        raise TypeError(f"{what}: expected an array in the processor's memory, found {found}: {error}") from error


def to_xarray(light_field: LightField) -> Any:
    """Returns the values as an `xarray.DataArray`."""
    import numpy
    import xarray

    _, _, rows, cols, _ = light_field.shape
    pitch_mm = light_field.pitch_mm
    coordinates = {
        "slope_y": ("view_y", light_field.slope_y),
        "slope_x": ("view_x", light_field.slope_x),
        "y_mm": ("row", ((rows - 1) / 2 - numpy.arange(rows)) * pitch_mm),
        "x_mm": ("col", (numpy.arange(cols) - (cols - 1) / 2) * pitch_mm),
        "rgb": ["r", "g", "b"],
    }
    attributes = {"long_name": "linear radiance, sRGB primaries", "pitch_mm": pitch_mm}
    if light_field.distance_mm is not None:
        attributes["distance_mm"] = light_field.distance_mm
    axes = ("view_y", "view_x", "row", "col", "rgb")
    return xarray.DataArray(light_field.radiance, dims=axes, coords=coordinates, attrs=attributes, name="radiance")
