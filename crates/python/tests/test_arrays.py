"""Arrays from and to Python. Some layouts are used without a copy, some are copied, some are
refused. All accepted layouts give the same values."""

from __future__ import annotations

import array
import gc
import struct
from typing import Any

import numpy
import pytest
from numpy.typing import NDArray

import lumistack
from lumistack import LightField

SHAPE = (2, 3, 4, 5, 3)
GEOMETRY: dict[str, Any] = {"pitch_mm": 1.0, "fov_deg": (20, 20)}


def values() -> NDArray[numpy.float32]:
    count = int(numpy.prod(SHAPE))
    # These values are exact in half floats.
    return ((numpy.arange(count) * 37 % 512) / 512).astype(numpy.float32).reshape(SHAPE)


def address(a: Any) -> int:
    return int(a.__array_interface__["data"][0])


def test_row_major_float32_is_used_where_it_is() -> None:
    given = values()
    light_field = LightField(given, **GEOMETRY)
    assert address(light_field.radiance) == address(given)
    assert light_field.radiance.shape == light_field.shape == SHAPE
    assert light_field.radiance.dtype == numpy.float32
    assert not light_field.radiance.flags.writeable


def test_a_light_field_keeps_the_array_alive_and_an_array_the_light_field() -> None:
    light_field = LightField(values(), **GEOMETRY)
    radiance = light_field.radiance
    del light_field
    gc.collect()
    trash = [values() * 0 for _ in range(100)]
    assert numpy.array_equal(radiance, values()) and trash


def test_an_exporter_cannot_move_its_memory_while_it_is_used() -> None:
    numbers = array.array("f", values().ravel().tolist())
    light_field = LightField(memoryview(numbers).cast("B").cast("f", SHAPE), **GEOMETRY)
    with pytest.raises(BufferError):
        numbers.append(1.0)
    del light_field
    gc.collect()
    numbers.append(1.0)


@pytest.mark.parametrize("dtype", ["float32", "float64", "float16", ">f4", ">f8", ">f2"])
@pytest.mark.parametrize(
    "layout", ["C", "F", "strided", "negative", "broadcast", "misaligned", "read-only", "transposed", "sliced"]
)
def test_every_layout_of_every_float_gives_the_same_values(dtype: str, layout: str) -> None:
    wanted = values()
    plain = wanted.astype(dtype)
    given: Any
    if layout == "C":
        given = plain
    elif layout == "F":
        given = numpy.asfortranarray(plain)
    elif layout == "strided":
        given = numpy.repeat(plain, 2, axis=3)[:, :, :, ::2]
    elif layout == "negative":
        given = plain[::-1, :, ::-1].copy()[::-1, :, ::-1]
    elif layout == "broadcast":
        wanted = numpy.broadcast_to(wanted[:1], SHAPE)
        given = numpy.broadcast_to(plain[:1], SHAPE)
    elif layout == "misaligned":
        raw = numpy.zeros(plain.nbytes + 1, numpy.uint8)
        given = raw[1:].view(plain.dtype).reshape(SHAPE)
        given[...] = plain
        assert not given.flags.aligned
    elif layout == "read-only":
        given = plain
        given.flags.writeable = False
    elif layout == "transposed":
        given = plain.transpose(4, 2, 0, 1, 3).copy().transpose(2, 3, 1, 4, 0)
    else:
        big = numpy.zeros((3, 4, 6, 9, 3), dtype)
        given = big[1:, :3, 2:, 3:8]
        given[...] = plain
    light_field = LightField(given, **GEOMETRY)
    assert numpy.array_equal(light_field.radiance, wanted)
    kept = dtype == "float32" and given.flags.c_contiguous and given.flags.aligned
    assert (address(light_field.radiance) == address(given)) == kept


def test_every_half_float_is_exact() -> None:
    halves = numpy.arange(1 << 16, dtype=numpy.uint16).view(numpy.float16)
    halves = halves[numpy.isfinite(halves)][: 3 * 21000].reshape(1, 1, 100, 210, 3)
    assert numpy.array_equal(LightField(halves, pitch_mm=1.0).radiance, halves.astype(numpy.float32))


@pytest.mark.parametrize(("dtype", "peak"), [("uint8", 255), ("uint16", 65535), (">u2", 65535)])
def test_unsigned_codes_are_decoded_from_srgb(dtype: str, peak: int) -> None:
    codes = (values() * peak).astype(dtype)
    encoded = codes.astype(numpy.float64) / peak
    linear = numpy.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    assert numpy.allclose(LightField(codes, **GEOMETRY).radiance, linear, atol=2e-7)


@pytest.mark.parametrize("dtype", ["int8", "int16", "int32", "int64", "uint32", "uint64", "bool", "complex64", "longdouble"])
def test_other_types_are_refused_by_name(dtype: str) -> None:
    with pytest.raises(TypeError, match=f"expected an array of float32.*found {numpy.dtype(dtype)}"):
        LightField(numpy.zeros(SHAPE, dtype), **GEOMETRY)


@pytest.mark.parametrize("thing", [None, 3, "text", [[1.0]], object(), numpy.float32(3.0), numpy.zeros((), "f4")])
def test_what_is_no_array_is_refused(thing: Any) -> None:
    with pytest.raises(TypeError, match="radiance: expected an array of floats, found"):
        LightField(thing, **GEOMETRY)


def test_structured_and_object_arrays_are_refused() -> None:
    with pytest.raises((TypeError, ValueError)):
        LightField(numpy.zeros(SHAPE, [("a", "f4"), ("b", "f4")]), **GEOMETRY)
    with pytest.raises((TypeError, ValueError)):
        LightField(numpy.zeros(SHAPE, object), **GEOMETRY)


@pytest.mark.parametrize("shape", [(3,), (4, 5, 3), (2, 3, 4, 5), (1, 2, 3, 4, 5, 3)])
def test_wrong_axes_are_named(shape: tuple[int, ...]) -> None:
    with pytest.raises(TypeError, match=r"expected an array with the axes \[view_y, view_x, row, col, rgb\], found an array of shape"):
        LightField(numpy.zeros(shape, "f4"), **GEOMETRY)


def test_other_numbers_of_channels_and_empty_arrays_are_refused() -> None:
    with pytest.raises(lumistack.DataError, match="expected 3 channels on the last axis, rgb, found 4"):
        LightField(numpy.zeros((2, 3, 4, 5, 4), "f4"), **GEOMETRY)
    with pytest.raises(lumistack.Error):
        LightField(numpy.zeros((2, 3, 0, 5, 3), "f4"), **GEOMETRY)
    with pytest.raises(lumistack.Error):
        LightField(numpy.zeros((0, 3, 4, 5, 3), "f8"), **GEOMETRY)


def test_tensors_of_other_libraries_come_by_their_array_method() -> None:
    class Tensor:
        def __array__(self, dtype: Any = None, copy: Any = None) -> NDArray[numpy.float32]:
            return values()

    assert numpy.array_equal(LightField(Tensor(), **GEOMETRY).radiance, values())


def test_numpy_is_not_needed_to_give_or_to_read_values() -> None:
    packed = struct.pack(f"{2 * 2 * 3}f", *[0.25] * 12)
    light_field = LightField(memoryview(packed).cast("f", (1, 1, 2, 2, 3)), pitch_mm=1.0)
    view = memoryview(light_field.array)
    assert (view.format, view.shape, view.readonly, view.c_contiguous) == ("f", (1, 1, 2, 2, 3), True, True)
    assert view.tobytes() == packed
    assert light_field.array.shape == [1, 1, 2, 2, 3]


def test_lent_arrays_cannot_be_written() -> None:
    light_field = LightField(values().astype("f8"), **GEOMETRY)
    with pytest.raises(ValueError, match="read-only"):
        light_field.radiance[0] = 1.0
    with pytest.raises((ValueError, BufferError)):
        light_field.radiance.flags.writeable = True


def test_numpy_takes_a_light_field_as_an_array() -> None:
    light_field = LightField(values(), **GEOMETRY)
    assert address(numpy.asarray(light_field)) == address(light_field.radiance)
    assert numpy.asarray(light_field, dtype="f8").dtype == numpy.float64
    copied = numpy.array(light_field)
    assert copied.flags.writeable and address(copied) != address(light_field.radiance)
    assert numpy.mean(light_field) == pytest.approx(float(values().mean()))


def test_weights_of_every_layout_mean_the_same(light_field: LightField) -> None:
    weights = numpy.ones((3, 3), "f4")
    weights[0] = 0.25
    reference = lumistack.factorize(light_field, iterations=2, weights=weights)
    for other in (weights.astype("f8"), numpy.asfortranarray(weights), weights[::-1].copy()[::-1]):
        made = lumistack.factorize(light_field, iterations=2, weights=other)
        assert all(numpy.array_equal(a, b) for a, b in zip(reference.layers, made.layers))
    even = lumistack.factorize(light_field, iterations=2)
    assert not numpy.array_equal(even.layers[0], reference.layers[0])
