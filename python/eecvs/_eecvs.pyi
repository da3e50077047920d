from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from types import TracebackType
from typing import Any, Literal, Protocol, SupportsIndex, TypeVar, Union, final, overload

import numpy as np
import numpy.typing as npt
from typing_extensions import Buffer, TypeAlias, Unpack

from ._types import Comparison, EncodeOptions, Info, Sensor, Truth, Written

__all__ = [
    "Capture",
    "Columns",
    "Decoder",
    "Encoder",
    "Picture",
    "Recording",
    "Slices",
    "Times",
    "Window",
    "_names",
    "_pack",
    "_panic",
    "_reopen",
    "_scenes",
    "_unpack",
    "_whole",
    "capture",
    "compare",
    "counts",
    "emulate",
    "encode",
    "open",
    "picture",
    "time_surface",
    "tore",
    "voxel",
    "write",
]

_Path: TypeAlias = Union[str, PathLike[str]]
_Dtype: TypeAlias = Literal["eecvs", "tonic", "faery", "expelliarmus", "metavision", "dv"]
_Array: TypeAlias = npt.NDArray[Any]
class _Frame(Protocol):
    @property
    def columns(self) -> Any: ...
    def __getitem__(self, name: str, /) -> Any: ...

class _ArrowTable(Protocol):
    @property
    def column_names(self) -> list[str]: ...
    def __getitem__(self, name: str, /) -> Any: ...

_Table: TypeAlias = Union[_Array, Mapping[str, npt.ArrayLike], Columns, Window, _Frame, _ArrowTable]
_Events: TypeAlias = Union[_Table, Recording, Iterable[_Table]]
_Batch: TypeAlias = Union[_Table, Sequence[_Table]]
_Floats: TypeAlias = Literal["float32", "float16"]
_Size: TypeAlias = Union[Sensor, tuple[int, int], Sequence[int]]
_Out = TypeVar("_Out", bound=_Array)

def open(
    path: _Path,
    *,
    dtype: Union[_Dtype, None] = None,
    width: Union[int, None] = None,
    height: Union[int, None] = None,
    time_unit: Union[Literal["s", "ms", "us", "ns"], None] = None,
    time_offset_us: int = 0,
    columns: Union[str, None] = None,
    leave_out_bad_events: bool = False,
    sort: bool = False,
    damaged: Literal["raise", "keep"] = "raise",
    max_events_per_window: Union[int, None] = None,
    max_work_per_window: Union[int, None] = None,
) -> Recording: ...
@final
class Recording:
    @property
    def sensor(self) -> Sensor: ...
    @property
    def format(self) -> str: ...
    @property
    def camera(self) -> Union[str, None]: ...
    @property
    def path(self) -> Union[PathLike[str], None]: ...
    @property
    def info(self) -> Info: ...
    @property
    def skipped(self) -> dict[str, int]: ...
    @property
    def losses(self) -> dict[str, int]: ...
    @property
    def assumptions(self) -> list[str]: ...
    @property
    def damage(self) -> Union[str, None]: ...
    @property
    def time(self) -> Times: ...
    def read(self) -> _Array: ...
    def columns(self) -> Columns: ...
    def causes(self) -> npt.NDArray[np.uint8]: ...
    def truth(self, t_us: int) -> Truth: ...
    def by_time(self, us: int, *, origin_us: Union[int, None] = None) -> Slices: ...
    def by_count(self, n: int) -> Slices: ...
    def close(self) -> None: ...
    def __iter__(self) -> Slices: ...
    def __enter__(self) -> Recording: ...
    def __exit__(
        self,
        exc_type: Union[type[BaseException], None] = None,
        exc: Union[BaseException, None] = None,
        traceback: Union[TracebackType, None] = None,
    ) -> None: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class Times:
    def __getitem__(self, times: slice[Union[int, None], Union[int, None], None], /) -> _Array: ...

@final
class Slices(Iterator[_Array]):
    @property
    def times(self) -> Union[tuple[int, int], None]: ...
    def __iter__(self) -> Slices: ...
    def __next__(self) -> _Array: ...

@final
class Columns:
    @property
    def t(self) -> npt.NDArray[np.int64]: ...
    @property
    def x(self) -> npt.NDArray[np.uint16]: ...
    @property
    def y(self) -> npt.NDArray[np.uint16]: ...
    @property
    def p(self) -> npt.NDArray[np.bool_]: ...
    @property
    def sensor(self) -> Union[Sensor, None]: ...
    def __len__(self) -> int: ...
    def __arrow_c_schema__(self) -> object: ...
    def __arrow_c_array__(
        self, requested_schema: Union[object, None] = None
    ) -> tuple[object, object]: ...

def write(
    path: _Path,
    events: _Events,
    *,
    sensor: Union[_Size, None] = None,
    format: Union[str, None] = None,
    overwrite: bool = False,
    allow_loss: bool = False,
    sort: bool = False,
    **options: Any,
) -> Written: ...
def encode(
    events: _Events,
    *,
    sensor: Union[_Size, None] = None,
    **options: Unpack[EncodeOptions],
) -> bytes: ...
@final
class Encoder:
    def __new__(cls, sensor: _Size, **options: Unpack[EncodeOptions]) -> Encoder: ...
    def push(self, events: _Table) -> bytes: ...
    def finish(self) -> bytes: ...
    @property
    def sensor(self) -> Sensor: ...
    @property
    def summary(self) -> dict[str, Any]: ...

@final
class Decoder:
    def __new__(
        cls,
        *,
        dtype: Union[_Dtype, None] = None,
        events: Literal["exact", "peaks"] = "exact",
        max_events_per_window: Union[int, None] = None,
        max_work_per_window: Union[int, None] = None,
    ) -> Decoder: ...
    def push(self, data: Buffer) -> list[Window]: ...
    def finish(self) -> list[Window]: ...
    @property
    def sensor(self) -> Union[Sensor, None]: ...
    @property
    def losses(self) -> dict[str, Any]: ...

@final
class Window:
    @property
    def t0_us(self) -> int: ...
    @property
    def duration_us(self) -> int: ...
    @property
    def sensor(self) -> Sensor: ...
    @property
    def is_exact(self) -> bool: ...
    @property
    def transform(self) -> str: ...
    @property
    def m(self) -> int: ...
    @property
    def events(self) -> _Array: ...
    def __len__(self) -> int: ...
    def coefficients(self, *, normalise: bool = False) -> npt.NDArray[np.float32]: ...
    def voxel(
        self,
        bins: int,
        *,
        weights: Literal["nearest", "bilinear"] = "nearest",
        polarity: Literal["signed", "split"] = "signed",
        normalise: bool = False,
    ) -> npt.NDArray[np.float32]: ...

@overload
def voxel(
    events: _Batch,
    bins: int,
    *,
    sensor: Union[_Size, None] = None,
    t0_us: Union[int, None] = None,
    t1_us: Union[int, None] = None,
    weights: Literal["nearest", "bilinear"] = "bilinear",
    polarity: Literal["signed", "split"] = "signed",
    dtype: Union[_Floats, None] = None,
    out: None = None,
) -> _Array: ...
@overload
def voxel(
    events: _Batch,
    bins: int,
    *,
    sensor: Union[_Size, None] = None,
    t0_us: Union[int, None] = None,
    t1_us: Union[int, None] = None,
    weights: Literal["nearest", "bilinear"] = "bilinear",
    polarity: Literal["signed", "split"] = "signed",
    dtype: Union[_Floats, None] = None,
    out: _Out,
) -> _Out: ...
@overload
def counts(
    events: _Batch,
    bins: int = 1,
    *,
    sensor: Union[_Size, None] = None,
    t0_us: Union[int, None] = None,
    t1_us: Union[int, None] = None,
    most: int = 255,
    dtype: Union[_Floats, Literal["uint8"], None] = None,
    out: None = None,
) -> _Array: ...
@overload
def counts(
    events: _Batch,
    bins: int = 1,
    *,
    sensor: Union[_Size, None] = None,
    t0_us: Union[int, None] = None,
    t1_us: Union[int, None] = None,
    most: int = 255,
    dtype: Union[_Floats, Literal["uint8"], None] = None,
    out: _Out,
) -> _Out: ...
@overload
def time_surface(
    events: _Batch,
    tau_us: float,
    *,
    sensor: Union[_Size, None] = None,
    t_us: Union[int, None] = None,
    dtype: Union[_Floats, None] = None,
    out: None = None,
) -> _Array: ...
@overload
def time_surface(
    events: _Batch,
    tau_us: float,
    *,
    sensor: Union[_Size, None] = None,
    t_us: Union[int, None] = None,
    dtype: Union[_Floats, None] = None,
    out: _Out,
) -> _Out: ...
@overload
def tore(
    events: _Batch,
    k: int = 3,
    *,
    sensor: Union[_Size, None] = None,
    t_us: Union[int, None] = None,
    dtype: Union[_Floats, None] = None,
    out: None = None,
) -> _Array: ...
@overload
def tore(
    events: _Batch,
    k: int = 3,
    *,
    sensor: Union[_Size, None] = None,
    t_us: Union[int, None] = None,
    dtype: Union[_Floats, None] = None,
    out: _Out,
) -> _Out: ...
def _reopen(function: str, of: Any, options: dict[str, Any]) -> Recording: ...
def _names() -> list[list[str]]: ...
def _pack(rows: Buffer, values: Sequence[int]) -> bytes: ...
def _unpack(packed: Buffer, values: Sequence[int], bytes_max: int) -> bytes: ...
def _scenes() -> list[tuple[str, str]]: ...
def emulate(
    scene: str,
    *,
    seed: int = 1,
    sensor: Union[_Size, None] = None,
    duration_us: Union[int, None] = None,
    start_us: int = 0,
    model: Literal[1, 2] = 2,
    pixel: Union[dict[str, float], None] = None,
    without: Union[Sequence[str], None] = None,
    dtype: Union[_Dtype, None] = None,
) -> Recording: ...
def compare(
    a: Union[_Table, Recording],
    b: Union[_Table, Recording],
    *,
    window_us: int = 32_768,
    sensor: Union[_Size, None] = None,
    align: bool = False,
) -> Comparison: ...
def picture(
    events: _Events,
    *,
    sensor: Union[_Size, None] = None,
    clip: int = 4,
    upscale: Union[int, None] = None,
) -> Picture: ...
@final
class Picture:
    @property
    def size(self) -> tuple[int, int]: ...
    def png(self) -> bytes: ...
    def save(self, path: _Path, *, overwrite: bool = False) -> None: ...
    def _repr_png_(self) -> bytes: ...
def _whole(value: SupportsIndex, name: str, least: int, most: int) -> int: ...
def _panic() -> None: ...

def capture(
    device: Union[str, None] = None,
    *,
    rate: str = "real",
    duration_s: Union[float, None] = None,
    max_events: Union[int, None] = None,
    wait: bool = False,
    queue_mib: int = 64,
    dtype: Union[_Dtype, None] = None,
) -> Capture: ...
@final
class Capture(Iterator[_Array]):
    @property
    def sensor(self) -> Union[Sensor, None]: ...
    @property
    def device(self) -> str: ...
    @property
    def model(self) -> str: ...
    @property
    def firmware(self) -> str: ...
    @property
    def losses(self) -> dict[str, int]: ...
    @property
    def report(self) -> Union[dict[str, Any], None]: ...
    def stop(self) -> None: ...
    def close(self) -> None: ...
    def __iter__(self) -> Capture: ...
    def __next__(self) -> _Array: ...
    def __enter__(self) -> Capture: ...
    def __exit__(
        self,
        exc_type: Union[type[BaseException], None] = None,
        exc: Union[BaseException, None] = None,
        traceback: Union[TracebackType, None] = None,
    ) -> None: ...
