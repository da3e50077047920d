"""The plain values of this package."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Literal, NamedTuple, Optional, TypedDict, Union

import numpy as np
import numpy.typing as npt


class Sensor(NamedTuple):
    """The size of a sensor in pixels, each side from 1 to 2048."""

    width: int
    height: int


def _of(
    names: str, formats: str, offsets: list[int], itemsize: int, aligned: bool = True
) -> np.dtype:
    return np.dtype(
        {
            "names": names.split(),
            "formats": formats.split(),
            "offsets": offsets,
            "itemsize": itemsize,
            "aligned": aligned,
        }
    )


#: The layouts of events by name; ``open(..., dtype=NAME)`` gives arrays of them.
DTYPES: dict[str, np.dtype] = {
    "eecvs": _of("t x y p", "<i8 <u2 <u2 ?", [0, 8, 10, 12], 16),
    "tonic": np.dtype([("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "?")]),
    "faery": np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), (("p", "on"), "?")]),
    "expelliarmus": _of("t x y p", "<i8 <i2 <i2 u1", [0, 8, 10, 12], 16),
    "metavision": _of("x y p t", "<u2 <u2 <i2 <i8", [0, 2, 4, 8], 16),
    "dv": _of("timestamp x y polarity", "<i8 <i2 <i2 i1", [0, 8, 10, 12], 16, False),
}


class Info(NamedTuple):
    """Counts, times and hashes of a recording, as ``eecvs info`` gives them."""

    camera: Optional[str]
    format: str
    width: int
    height: int
    events: int
    on: int
    off: int
    t_first_us: Optional[int]
    t_last_us: Optional[int]
    times_back: int
    back_max_us: int
    duration_s: float
    rate_eps: float
    sum_x: int
    sum_y: int
    #: SHA-256 over the columns t (int64), x, y (uint16), p (uint8), one after the other.
    sha256_events: str
    #: Sum of a hash of every event, whatever their order.
    xxh128_sum_events: str
    assumptions: tuple[str, ...]
    skipped: dict[str, int]
    damage: Optional[str]


class Comparison(NamedTuple):
    """Distortion of recording b against recording a, as ``eecvs compare`` gives it."""

    events_a: int
    events_b: int
    #: Share of a's events that b holds, 0 to 1.
    exact_fraction: float
    #: Share of b's events that a holds, 0 to 1.
    exact_fraction_b: float
    missing_events: int
    surplus_events: int
    surplus_fraction: float
    #: Mean squared error of the frames of polarities, 0 to 4.
    mse: float
    #: Structural similarity of these frames, -1 to 1.
    ssim: float
    #: Mean Wasserstein-1 distance of the windows' event times, in ms.
    emd_time_ms: float
    #: Cost of the matching of events pixel by pixel, per event of a, in us.
    emd_pixel_us: float
    #: How far b's clock is ahead of a's, in us; None if no constant offset was found.
    clock_offset_us: Optional[int]
    #: Whether that offset was removed.
    aligned: bool


class Written(NamedTuple):
    """What ``write`` wrote."""

    path: str
    events_in: int
    events_out: int
    #: Counts of what the format could not hold, with ``allow_loss=True``.
    lost: dict[str, int]


#: What caused an event of an emulated scene, by the numbers of ``Recording.causes()``.
CAUSES: tuple[str, ...] = ("signal", "leak", "shot noise", "hot", "stuck")


class Truth(NamedTuple):
    """What is really seen at each pixel of a scene, from ``Recording.truth()``."""

    #: (H, W) uint8: the number of the object; 0 is the background.
    object: npt.NDArray[np.uint8]
    #: (H, W, 2) float32: optical flow in pixels per second, to the right and down.
    flow: npt.NDArray[np.float32]
    #: (H, W) float32: depth relative to that of the picture's middle, NaN in objects; None in a scene without depth.
    depth: Optional[npt.NDArray[np.float32]]
    #: What the objects are, by their numbers: ``"background"``, ``"box"`` or ``"lamp"``.
    objects: tuple[str, ...]


class EncodeOptions(TypedDict, total=False):
    """The options of ``eecvs encode``; None is the default."""

    mode: Literal["hybrid", "transform"]
    time_tolerance_us: Union[int, None]
    bins: Union[int, None]
    max_emd_us: Union[int, None]
    max_nmse: Union[float, None]
    coder: Union[Literal["plain", "fast", "quick", "dense"], None]
    effort: int
    key_windows: int
    key_us: Union[int, None]
    scans: Literal["auto", "off"]
    region: Union[tuple[int, int, int, int], None]
    hot_pixels: Union[str, PathLike[str], Iterable[tuple[int, int]], None]
    isolated: bool
    keep_order: bool
    bytes_per_second: Union[int, None]
    transform: Literal["auto", "best", "dct", "dtft", "dwt"]
    few_as_times: bool
    m: int
    grid: Union[int, None]
    step_log2: int
    max_error: Union[float, None]
    window_us: int
    origin_us: Union[int, None]
    every_window: bool
    thresholds: Union[str, PathLike[str], None]
    auto_window: bool
    kernel: Literal["table", "recurrence", "precise", "micromath", "libm"]
    window_events: int
    frame_bytes: int
    reorder_us: Union[int, None]
    threads: Union[int, None]
    allow_loss: bool
    sort: bool
