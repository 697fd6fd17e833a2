"""Lumistack turns 3D scenes into patterns for layered glasses-free displays.

    import lumistack

    display = lumistack.Display("paper-three-layer", resolution=(210, 131))
    light_field = lumistack.render("scene.glb", display, samples=32)      # or LightField(array, ...) of any renderer
    stack = lumistack.factorize(light_field, display, iterations=20)
    picture = lumistack.simulate(stack, slope=(0.05, 0.0))                # [row, col, rgb], linear
    lumistack.write(stack, "web_simulator", "preview")

Arrays are linear light with sRGB primaries; x points right, y up, z to the viewer, lengths are millimetres, slopes are tangents.
"""

from lumistack._errors import (
    DataError,
    Error,
    FactorizeError,
    FileError,
    InternalError,
    LumistackWarning,
    MissingFileError,
    PluginError,
    RenderError,
    SceneError,
    SettingError,
)
from lumistack._lumistack import (
    HAS_PANELS,
    Array,
    Display,
    LayerStack,
    LightField,
    Scene,
    __version__,
    defaults,
    displays,
    factorize,
    info,
    main,
    plugins,
    render,
    report,
    run,
    set_threads,
    simulate,
    write,
)
from lumistack._progress import set_progress
from lumistack._show import srgb

__all__ = [
    "HAS_PANELS",
    "Array",
    "DataError",
    "Display",
    "Error",
    "FactorizeError",
    "FileError",
    "InternalError",
    "LayerStack",
    "LightField",
    "LumistackWarning",
    "MissingFileError",
    "PluginError",
    "RenderError",
    "Scene",
    "SceneError",
    "SettingError",
    "__version__",
    "defaults",
    "displays",
    "factorize",
    "info",
    "main",
    "plugins",
    "render",
    "report",
    "run",
    "set_progress",
    "set_threads",
    "simulate",
    "srgb",
    "write",
]
