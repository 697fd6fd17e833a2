"""Light fields and patterns in notebooks and as plots."""

from __future__ import annotations

import base64
import html
import struct
import zlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lumistack._lumistack import LayerStack, LightField

#: Width of thumbnails, pixels.
_WIDTH = 320
#: Largest number of pictures per axis that a notebook contains: `_VIEWS` along a single axis,
#: `_VIEWS_OF_TWO` if both axes have several views. More would make the notebook's file large.
_VIEWS = 9
_VIEWS_OF_TWO = 5


def light_field(light_field: LightField) -> str | None:
    """Returns the HTML of a light field: a view with a slider for each axis of views, and a table
    of properties. None without NumPy."""
    if not _has_numpy():
        return None
    view_rows, view_cols, rows, cols, _ = light_field.shape
    most = _VIEWS if 1 in (view_rows, view_cols) else _VIEWS_OF_TWO
    chosen = [_spread(count, most) for count in (view_rows, view_cols)]
    views = [[_png(light_field.radiance[v, u]) for u in chosen[1]] for v in chosen[0]]
    kind = "parallel" if light_field.distance_mm is None else f"perspective, from {light_field.distance_mm:g} mm"
    facts = {
        "views": f"{view_cols} × {view_rows}, {kind}",
        "pixels": f"{cols} × {rows}, {light_field.pitch_mm:g} mm each",
        "slopes": f"{_range(light_field.slope_x)} across, {_range(light_field.slope_y)} up",
    }
    return _viewer("LightField", facts, views)


def layer_stack(stack: LayerStack) -> str | None:
    """Returns the HTML of patterns: the seen picture with a slider for the horizontal direction,
    the masks of the first frame, and a table of properties. None without NumPy."""
    if not _has_numpy():
        return None
    slopes = sorted(stack.display.slopes[0])
    picks = [slopes[i] for i in _spread(len(slopes), _VIEWS)]
    seen = [[_png(stack.simulate((slope, 0.0))) for slope in picks]]
    facts = {
        "display": html.escape(stack.display.name),
        "layers": ", ".join(_number(distance) for distance in stack.display.layer_distances_mm) + " mm",
        "frames": f"{stack.frames}, at a brightness of {stack.brightness:g}",
    }
    if stack.history:
        facts["PSNR"] = f"{stack.history[-1][2]:.2f} dB over the views that the solver used"
    patterns = [f'<img src="{_png(layer[0])}" alt="layer {n}" width="120">' for n, layer in enumerate(stack.layers)]
    return _viewer("LayerStack", facts, seen) + f"<p>first frame, rear to front<br>{' '.join(patterns)}</p>"


def plot_view(light_field: LightField, view: tuple[int, int] | None, ax: Any) -> Any:
    """Draws a view as a picture, with axes in millimetres."""
    view_rows, view_cols, rows, cols, _ = light_field.shape
    v, u = (view_rows // 2, view_cols // 2) if view is None else view
    width, height = cols * light_field.pitch_mm, rows * light_field.pitch_mm
    ax = _axes(ax)
    ax.imshow(srgb(light_field[v, u]), extent=(-width / 2, width / 2, -height / 2, height / 2))
    ax.set_title(f"view [{v}, {u}], slope ({_number(light_field.slope_x[u], 3)}, {_number(light_field.slope_y[v], 3)})")
    ax.set_xlabel("x, mm")
    ax.set_ylabel("y, mm")
    return ax


def plot_patterns(stack: LayerStack, frame: int) -> Any:
    """Draws the masks of a frame, and the picture of all frames as seen from the middle. Returns the
    axes, since notebooks would show a returned figure twice."""
    from matplotlib import pyplot

    if not -stack.frames <= frame < stack.frames:
        raise IndexError(f"frame: expected {-stack.frames} to {stack.frames - 1}, found {frame}")
    pictures = [
        (f"layer {n}, {_number(distance)} mm", layer[frame])
        for n, (distance, layer) in enumerate(zip(stack.display.layer_distances_mm, stack.layers, strict=True))
    ]
    pictures.append((f"seen, {_count(stack.frames, 'frame')}", stack.simulate()))
    figure, axes = pyplot.subplots(1, len(pictures), squeeze=False, figsize=(3.2 * len(pictures), 2.6), layout="constrained")
    for ax, (title, picture) in zip(axes[0], pictures, strict=True):
        ax.imshow(srgb(picture))
        ax.set_title(title)
        ax.set_axis_off()
    last = stack.frames - 1
    figure.suptitle(f"frame {frame % stack.frames} of 0 to {last}" if last else "the only frame")
    return axes[0]


def plot_history(stack: LayerStack, ax: Any) -> Any:
    """Draws PSNR over iterations."""
    if not stack.history:
        raise ValueError("history: expected patterns that factorize() has made, found others")
    ax = _axes(ax)
    ax.plot([step[0] for step in stack.history], [step[2] for step in stack.history], marker=".")
    ax.set_xlabel("iterations")
    ax.set_ylabel("PSNR of the solver's views, dB")
    return ax


def _number(value: float, digits: int | None = None) -> str:
    """Returns a number with a minus sign, not a hyphen, and without the sign of -0.0."""
    text = f"{value:g}" if digits is None else f"{round(value, digits) + 0.0:.{digits}f}"
    return text.replace("-", "\N{MINUS SIGN}")


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _axes(ax: Any) -> Any:
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def _has_numpy() -> bool:
    try:
        import numpy  # noqa: F401
    except ImportError:
        return False
    return True


def _spread(count: int, most: int) -> list[int]:
    """Returns at most `most` indices, spread evenly over an axis from its first to its last index."""
    if count <= most:
        return list(range(count))
    return [round(i * (count - 1) / (most - 1)) for i in range(most)]


def _range(slopes: list[float]) -> str:
    return f"{_number(min(slopes), 3)} to {_number(max(slopes), 3)}" if len(slopes) > 1 else _number(slopes[0], 3)


def srgb(linear: Any) -> Any:
    """Converts linear light 0..1 to 8-bit sRGB codes (IEC 61966-2-1), for files and screens. The shape stays."""
    import numpy

    # Values that are not finite are black or white, since they have no code.
    light = numpy.clip(numpy.nan_to_num(numpy.asarray(linear, numpy.float32)), 0.0, 1.0)
    encoded = numpy.where(light <= 0.0031308, 12.92 * light, 1.055 * numpy.power(light, 1 / 2.4) - 0.055)
    return (255.0 * encoded + 0.5).astype(numpy.uint8)


def _png(linear: Any) -> str:
    """Returns a picture, reduced to a thumbnail, as a PNG in a data URI."""
    import numpy

    step = max(1, -(-linear.shape[1] // _WIDTH))
    rows, cols = (count // step for count in linear.shape[:2])
    if step > 1 and rows and cols:
        linear = numpy.asarray(linear)[: rows * step, : cols * step].reshape(rows, step, cols, step, 3).mean((1, 3))
    codes = srgb(linear)
    # In PNG every row begins with the number of its filter; 0 means none.
    lines = b"".join(b"\x00" + row.tobytes() for row in codes)
    header = struct.pack(">IIBBBBB", codes.shape[1], codes.shape[0], 8, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(lines)), (b"IEND", b"")]
    file = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )
    return "data:image/png;base64," + base64.b64encode(file).decode()


def _viewer(name: str, facts: dict[str, str], views: list[list[str]]) -> str:
    """Returns the HTML of a table next to a picture; sliders select one of several pictures."""
    rows = "".join(f"<tr><th style='text-align:left'>{key}</th><td style='text-align:left'>{value}</td></tr>" for key, value in facts.items())
    middle = (len(views) // 2, len(views[0]) // 2)
    pictures = "".join(
        f'<img src="{picture}" alt="view {v}, {u}" data-at="{v},{u}" style="width:{_WIDTH}px;image-rendering:auto'
        f'{"" if (v, u) == middle else ";display:none"}">'
        for v, row in enumerate(views)
        for u, picture in enumerate(row)
    )
    change = (
        "const b=this.closest('[data-lumistack]'),a=n=>b.querySelector('[name='+n+']')?.value??0;"
        "b.querySelectorAll('img[data-at]').forEach(i=>i.style.display=i.dataset.at==a('v')+','+a('u')?'':'none')"
    )
    sliders = "".join(
        f'<label style="display:block">{text} <input type="range" name="{axis}" min="0" max="{count - 1}" value="{at}" oninput="{html.escape(change)}"></label>'
        for axis, text, count, at in (("u", "left to right", len(views[0]), middle[1]), ("v", "top to bottom", len(views), middle[0]))
        if count > 1
    )
    return f"<div data-lumistack><b>lumistack.{name}</b><table>{rows}</table>{pictures}{sliders}</div>"
