"""Functions that restore pickled objects."""

from __future__ import annotations

from typing import Any

from lumistack import _lumistack
from lumistack._lumistack import Display, LayerStack, LightField


def light_field(radiance: Any, how: dict[str, Any], kept: dict[str, Any] | None = None) -> LightField:
    made = LightField(radiance, **how)
    return made if kept is None else _lumistack._light_field_with(made, kept)


def layer_stack(layers: Any, emission: Any, display: Display, brightness: float, solved: Any = None) -> LayerStack:
    made = LayerStack(layers, display, emission=emission, brightness=brightness)
    return made if solved is None else _lumistack._layer_stack_with(made, solved)
