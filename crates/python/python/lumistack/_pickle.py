"""Functions that restore pickled objects."""

from __future__ import annotations

from typing import Any

from lumistack._lumistack import Display, LayerStack, LightField


def light_field(radiance: Any, how: dict[str, Any]) -> LightField:
    return LightField(radiance, **how)


def layer_stack(layers: Any, emission: Any, display: Display, brightness: float) -> LayerStack:
    return LayerStack(layers, display, emission=emission, brightness=brightness)
