from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias, final

from _typeshed import ReadableBuffer
from numpy import float32
from numpy.typing import NDArray

class _HasArray(Protocol):
    def __array__(self) -> Any: ...

class _Stage(Protocol):
    def GetRootLayer(self) -> Any: ...

_Path: TypeAlias = str | PathLike[str]
_Callback: TypeAlias = Callable[[str, float], object]
_Numbers: TypeAlias = Sequence[float] | NDArray[Any]
_Pair: TypeAlias = _Numbers
_Size: TypeAlias = Sequence[int] | NDArray[Any]
_ArrayLike: TypeAlias = ReadableBuffer | _HasArray
_DisplayLike: TypeAlias = Display | str | PathLike[str] | Mapping[str, Any]

HAS_PANELS: bool
__version__: str

@final
class Array:
    @property
    def shape(self) -> list[int]: ...
    def __buffer__(self, flags: int, /) -> memoryview: ...

@final
class Display:
    def __new__(
        cls,
        what: _DisplayLike | None = None,
        *,
        resolution: _Size | None = None,
        views: _Size | Literal["auto"] | dict[str, _Size] | None = None,
        fov_deg: _Pair | None = None,
        frames: int | None = None,
        brightness: float | None = None,
        sampling: Literal["nearest", "bilinear"] | None = None,
        missing: Literal["drop", "clear"] | None = None,
    ) -> Display: ...
    @property
    def name(self) -> str: ...
    @property
    def frames(self) -> int: ...
    @property
    def brightness(self) -> float: ...
    @property
    def layer_distances_mm(self) -> tuple[float, ...]: ...
    @property
    def layer_shapes(self) -> tuple[tuple[int, int, int, int], ...]: ...
    @property
    def emission_shape(self) -> tuple[int, int, int, int, int, int] | None: ...
    @property
    def light_field_shape(self) -> tuple[int, int, int, int, int]: ...
    @property
    def slopes(self) -> tuple[list[float], list[float]]: ...
    @property
    def pitch_mm(self) -> float: ...
    @property
    def distance_mm(self) -> float | None: ...
    def depth_of_field_mm(self) -> tuple[float, float] | None: ...
    def adapted_to(self, light_field: LightField) -> Display: ...
    def to_dict(self) -> dict[str, Any]: ...
    def to_toml(self) -> str: ...
    def save(self, path: _Path) -> None: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class LightField:
    def __new__(
        cls,
        radiance: _ArrayLike,
        *,
        display: _DisplayLike | None = None,
        pitch_mm: float | None = None,
        fov_deg: _Pair | None = None,
        slope_x: _Numbers | None = None,
        slope_y: _Numbers | None = None,
        distance_mm: float | None = None,
    ) -> LightField: ...
    @classmethod
    def open(
        cls,
        path: _Path,
        *,
        display: _DisplayLike | None = None,
        callback: _Callback | None = None,
        **geometry: Any,
    ) -> LightField: ...
    def exposed(
        self, exposure_ev: float = 0.0, *, tone: Literal["linear", "khronos-neutral", "agx"] = "linear"
    ) -> LightField: ...
    def save(self, path: _Path, *, info: Mapping[str, Any] | None = None) -> None: ...
    def factorize(
        self,
        display: _DisplayLike | None = None,
        *,
        brightness: float | None = None,
        frames: int | None = None,
        solver: Literal["auto", "multiplicative", "block-exact", "extrapolated"] | None = None,
        iterations: int | None = None,
        start: Literal["auto", "random", "smooth", "content"] | None = None,
        coarse_levels: int | None = None,
        coarse_iterations: int | None = None,
        levels: bool | None = None,
        weights: _ArrayLike | None = None,
        eyes: Sequence[Mapping[str, Any]] | None = None,
        eye_floor: float | None = None,
        warm_start: LayerStack | None = None,
        seed: int | None = None,
        callback: _Callback | None = None,
    ) -> LayerStack: ...
    def to_xarray(self) -> Any: ...
    def plot(self, view: tuple[int, int] | None = None, *, ax: Any = None) -> Any: ...
    @property
    def radiance(self) -> NDArray[float32]: ...
    @property
    def array(self) -> Array: ...
    @property
    def shape(self) -> tuple[int, int, int, int, int]: ...
    @property
    def pitch_mm(self) -> float: ...
    @property
    def slope_x(self) -> list[float]: ...
    @property
    def slope_y(self) -> list[float]: ...
    @property
    def distance_mm(self) -> float | None: ...
    @property
    def display(self) -> Display | None: ...
    @property
    def info(self) -> dict[str, Any]: ...
    @property
    def dtype(self) -> Any: ...
    @property
    def ndim(self) -> int: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: Any, /) -> Any: ...
    def __iter__(self) -> Iterator[NDArray[float32]]: ...
    def __dlpack__(self, **options: Any) -> Any: ...
    def __dlpack_device__(self) -> tuple[int, int]: ...
    def _repr_html_(self) -> str | None: ...
    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class LayerStack:
    def __new__(
        cls,
        layers: Sequence[_ArrayLike],
        display: _DisplayLike,
        *,
        emission: _ArrayLike | None = None,
        brightness: float | None = None,
    ) -> LayerStack: ...
    @classmethod
    def open(cls, folder: _Path, *, display: _DisplayLike | None = None) -> LayerStack: ...
    def save(self, folder: _Path) -> None: ...
    @property
    def layers(self) -> tuple[NDArray[float32], ...]: ...
    @property
    def arrays(self) -> tuple[Array, ...]: ...
    @property
    def emission(self) -> NDArray[float32] | None: ...
    @property
    def display(self) -> Display: ...
    @property
    def frames(self) -> int: ...
    @property
    def brightness(self) -> float: ...
    @property
    def history(self) -> list[tuple[int, float, float]]: ...
    @property
    def solution(self) -> dict[str, Any] | None: ...
    def psnr(self, light_field: LightField, *, weights: _ArrayLike | None = None, raw: bool = False) -> float: ...
    def psnr_zone(self, references: LightField, *, callback: _Callback | None = None) -> dict[str, Any]: ...
    def weights(self, light_field: LightField, *, weights: _ArrayLike | None = None) -> NDArray[float32]: ...
    def simulate(
        self,
        slope: _Pair | None = None,
        *,
        angle_deg: _Pair | None = None,
        eye_mm: _Numbers | None = None,
        raw: bool = False,
    ) -> NDArray[float32]: ...
    def write(
        self,
        plugin: str,
        folder: _Path,
        *,
        target: LightField | None = None,
        callback: _Callback | None = None,
        **params: Any,
    ) -> list[Path]: ...
    def plot(self, frame: int = 0) -> Any: ...
    def plot_history(self, *, ax: Any = None) -> Any: ...
    def _repr_html_(self) -> str | None: ...
    def views(self, like: LightField, *, raw: bool = False, callback: _Callback | None = None) -> LightField: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class Scene:
    def __new__(
        cls,
        path: _Path | _Stage,
        *,
        time: float | None = None,
        animation: str | int | None = None,
        variant: str | int | None = None,
        variants: Sequence[str] | None = None,
        light: Mapping[str, Any] | None = None,
        importer: Mapping[str, Any] | None = None,
        callback: _Callback | None = None,
    ) -> Scene: ...
    @property
    def path(self) -> Path: ...
    @property
    def triangles(self) -> int: ...
    @property
    def cameras(self) -> list[str]: ...
    @property
    def materials(self) -> list[str]: ...
    @property
    def animations(self) -> list[tuple[str, float]]: ...
    @property
    def variants(self) -> list[str]: ...
    @property
    def duration(self) -> float | None: ...
    @property
    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]: ...
    @staticmethod
    def from_splats(
        splats: Mapping[str, Any] | Sequence[Mapping[str, Any]],
        *,
        light: Mapping[str, Any] | None = None,
        name: str = "splats",
    ) -> Scene: ...
    @property
    def splats(self) -> list[dict[str, Any]]: ...

def render(
    scene: Scene | _Path | _Stage,
    display: _DisplayLike | None = None,
    *,
    samples: int | None = None,
    zone_samples: int | Literal["auto"] | None = None,
    max_bounces: int | None = None,
    clamp: float | None = None,
    denoise: Literal["auto", "off", "shared", "guided", "oidn"] | None = None,
    angular_filter: Literal["point", "bin", "display"] | None = None,
    lens_deg: float | None = None,
    camera: str | int | None = None,
    look_from: tuple[float, float] | None = None,
    fit_depth: Literal["auto", "off", "move", "compress"] | None = None,
    depth_scale: float | None = None,
    window: Mapping[str, Any] | None = None,
    exposure_ev: float | None = None,
    tone: Literal["auto", "linear", "khronos-neutral", "agx"] | None = None,
    light: Mapping[str, Any] | None = None,
    seed: int | None = None,
    zone_directions: int = 0,
    cache: _Path | None = None,
    callback: _Callback | None = None,
) -> LightField: ...
def factorize(
    light_field: LightField,
    display: _DisplayLike | None = None,
    *,
    brightness: float | None = None,
    frames: int | None = None,
    solver: Literal["auto", "multiplicative", "block-exact", "extrapolated"] | None = None,
    iterations: int | None = None,
    start: Literal["auto", "random", "smooth", "content"] | None = None,
    coarse_levels: int | None = None,
    coarse_iterations: int | None = None,
    levels: bool | None = None,
    weights: _ArrayLike | None = None,
    eyes: Sequence[Mapping[str, Any]] | None = None,
    eye_floor: float | None = None,
    warm_start: LayerStack | None = None,
    seed: int | None = None,
    callback: _Callback | None = None,
) -> LayerStack: ...
def simulate(
    stack: LayerStack,
    slope: _Pair | None = None,
    *,
    angle_deg: _Pair | None = None,
    eye_mm: _Numbers | None = None,
    raw: bool = False,
) -> NDArray[float32]: ...
def write(
    what: LayerStack | LightField,
    plugin: str,
    folder: _Path,
    *,
    display: _DisplayLike | None = None,
    target: LightField | None = None,
    callback: _Callback | None = None,
    **params: Any,
) -> list[Path]: ...
def report(
    stack: LayerStack,
    light_field: LightField,
    folder: _Path,
    *,
    title: str | None = None,
    weights: _ArrayLike | None = None,
    callback: _Callback | None = None,
) -> dict[str, Any]: ...
def run(
    job: _Path | Mapping[str, Any], folder: _Path | None = None, *, callback: _Callback | None = None
) -> dict[str, Any]: ...
def info(path: _Path, *, callback: _Callback | None = None) -> dict[str, Any]: ...
def plugins() -> list[dict[str, Any]]: ...
def displays() -> list[str]: ...
def defaults() -> dict[str, Any]: ...
def set_threads(count: int) -> None: ...
def _light_field_with(light_field: LightField, kept: dict[str, Any]) -> LightField: ...
def _layer_stack_with(stack: LayerStack, solved: Any) -> LayerStack: ...
def main(arguments: Sequence[str], program: str | None = None) -> int: ...
