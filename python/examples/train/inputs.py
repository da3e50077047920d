"""What a network is given: arrays of the windows of a clip, of the events as they are or after encoding and decoding.

| input | channels | of a pixel's events |
|---|---|---|
| `dct`, `dtft`, `dwt` | M, 4 M, 2 M rounded up to a power of two | coefficients of the codec, M of them kept |
| `auto` | those of the window's transform | the same, by the transform that the window's density chooses |
| `best` | M | those of `dct`; few events are sent as times (`transform="best"`) |
| `bins` | M | ON minus OFF in M equal bins of time |
| `voxel` | M | the same by bilinear weights |
| `tore` | M | logarithms of the ages of the latest M / 2 ON and M / 2 OFF events, and 0 for none |
| `ces` | 2 M | sum of p exp(-i 2 pi f_k u), f_0 = 0, the others of the law abs(N(0, M / 4)) |
| `counts` | 2 | numbers of ON and of OFF events: what is there without any times |

Arrays have few active pixels, and are kept as the values of these.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Union

import numpy as np

import eecvs
from clips import WINDOW_US, Clip

TRANSFORMS = ("dct", "dtft", "dwt", "auto", "best")
ARRAYS = ("bins", "voxel", "tore", "ces", "counts")
#: The step of coefficients that stand for the events as they are, as a power of two.
FINE = -10
#: TORE's value of an event that never was: ages end at 5 s.
NOTHING = math.log(5e6 + 1) - math.log(151)

#: How events are encoded: by "2^s", the step of coefficients, by "n us", the largest mean error of times, as "lossless"
#: events, or as "bins". None is the events as they are.
Setting = Union[str, None]


class Sparse(NamedTuple):
    """The array of a window: its transform or form, the places of its active pixels, and their values, (N, C)."""

    kind: str
    places: Any
    values: Any


def channels(name: str, m: int) -> dict[str, int]:
    """Returns the number of channels of each kind of array that an input has."""
    dwt = 1 << (2 * m - 1).bit_length()
    of = {"dct": m, "dtft": 4 * m, "dwt": dwt, "bins": m, "voxel": m, "tore": m, "ces": 2 * m, "counts": 2}
    if name == "auto":
        return {kind: of[kind] for kind in ("dct", "dtft", "dwt")}
    kind = "dct" if name == "best" else name
    return {kind: of[kind]}


def arrays(
    name: str, m: int, clip: Clip, setting: Setting = None, thresholds: Union[Path, None] = None
) -> tuple[list[Sparse], int]:
    """Returns the arrays of all windows of a clip, and the bytes that were sent for them; 0 of events as they are.

    `thresholds` is the file of the densities that choose transforms, by default those of the codec.
    """
    if name in TRANSFORMS:
        return _coefficients(name, m, clip, setting, thresholds)
    if setting == "bins":
        return _exact_bins(m, clip)
    events, size = _decoded(clip, setting)
    parts = clip.cut(events)
    made = []
    for index, part in enumerate(parts):
        t0_us, t1_us = clip.times(index)
        if name == "tore":
            before = events[: np.searchsorted(events["t"], t1_us)]
            made.append(_tore(before, m, clip.sensor, t1_us))
        elif name == "ces":
            made.append(_ces(part, m, clip.sensor, t0_us))
        else:
            volume = _volume(name, part, m, clip.sensor, t0_us, t1_us)
            made.append(_sparse(name, volume, _places(part, clip.sensor)))
    return made, size


def _places(events: Any, sensor: tuple[int, int]) -> Any:
    return np.unique(events["y"].astype(np.int64) * sensor[0] + events["x"])


def _sparse(kind: str, volume: Any, places: Any) -> Sparse:
    return Sparse(kind, places, np.ascontiguousarray(volume.reshape(len(volume), -1)[:, places].T, np.float32))


def _volume(name: str, events: Any, m: int, sensor: tuple[int, int], t0_us: int, t1_us: int) -> Any:
    if name == "counts":
        return eecvs.counts(events, 1, sensor=sensor, t0_us=t0_us, t1_us=t1_us, dtype="float32")
    weights: Any = "bilinear" if name == "voxel" else "nearest"
    return eecvs.voxel(events, m, sensor=sensor, t0_us=t0_us, t1_us=t1_us, weights=weights)


def _tore(events: Any, m: int, sensor: tuple[int, int], t_us: int) -> Sparse:
    # Of all pixels that ever had an event: ages outlive windows.
    volume = NOTHING - eecvs.tore(events, m // 2, sensor=sensor, t_us=t_us)
    return _sparse("tore", volume, _places(events, sensor))


@lru_cache(maxsize=None)
def frequencies(m: int) -> Any:
    """Returns the frequencies of CES in turns per window, by the law of the project's own study."""
    others = np.abs(np.random.default_rng(42).normal(0, m / 4, m - 1))
    return np.sort(np.concatenate([[0.0], others]))


def _ces(events: Any, m: int, sensor: tuple[int, int], t0_us: int) -> Sparse:
    if not len(events):
        return Sparse("ces", np.empty(0, np.int64), np.empty((0, 2 * m), np.float32))
    places = events["y"].astype(np.int64) * sensor[0] + events["x"]
    order = np.argsort(places, kind="stable")
    active, first = np.unique(places[order], return_index=True)
    turns = (events["t"][order] - t0_us)[:, None] / WINDOW_US * frequencies(m)
    atoms = np.where(events["p"][order], 1.0, -1.0)[:, None] * np.exp(-2j * np.pi * turns)
    sums = np.add.reduceat(atoms, first, axis=0)
    values = np.stack([sums.real, sums.imag], axis=2).reshape(len(active), 2 * m)
    return Sparse("ces", active, values.astype(np.float32))


def _options(clip: Clip) -> Any:
    return {"sensor": clip.sensor, "window_us": WINDOW_US, "origin_us": clip.start_us, "threads": 1}


def _windows(frames: bytes) -> list[eecvs.Window]:
    # Times are not solved for: arrays of coefficients do not need them.
    decoder = eecvs.Decoder(events="peaks", max_work_per_window=0)
    return decoder.push(frames) + decoder.finish()


def _in_place(clip: Clip, made: dict[int, Sparse], empty: Sparse) -> list[Sparse]:
    """Puts windows at their places: those without events are not sent."""
    return [made.get(index, empty) for index in range(clip.count)]


def _coefficients(
    name: str, m: int, clip: Clip, setting: Setting, thresholds: Union[Path, None]
) -> tuple[list[Sparse], int]:
    options = {"transform": name, "m": m, "thresholds": thresholds, **_options(clip)}
    if setting is None:
        # Of exact events the decoder makes the coefficients that the encoder would have sent.
        transform = "dct" if name == "best" else name
        options |= {"mode": "hybrid", "coder": "quick", "transform": transform, "step_log2": FINE}
    else:
        options |= {"mode": "transform", "coder": "dense", "step_log2": int(setting.removeprefix("2^"))}
    frames = eecvs.encode(clip.events, **options)
    made = {}
    for window in _windows(frames):
        places = _places(window.events, clip.sensor)
        made[(window.t0_us - clip.start_us) // WINDOW_US] = _sparse(window.transform, window.coefficients(), places)
    # Without events it is sparse, whatever the transform is called.
    kind, count = list(channels(name, m).items())[-1]
    empty = Sparse(kind, np.empty(0, np.int64), np.empty((0, count), np.float32))
    return _in_place(clip, made, empty), 0 if setting is None else len(frames)


def _exact_bins(m: int, clip: Clip) -> tuple[list[Sparse], int]:
    frames = eecvs.encode(clip.events, coder="dense", bins=m, **_options(clip))
    made = {}
    for window in _windows(frames):
        places = _places(window.events, clip.sensor)
        made[(window.t0_us - clip.start_us) // WINDOW_US] = _sparse("bins", window.voxel(m), places)
    empty = Sparse("bins", np.empty(0, np.int64), np.empty((0, m), np.float32))
    return _in_place(clip, made, empty), len(frames)


#: What came back, by the identity of the clip's events, which are kept with it, and the setting.
_DECODED: dict[tuple[int, str], tuple[Any, Any, int]] = {}


def _decoded(clip: Clip, setting: Setting) -> tuple[Any, int]:
    """Returns the events that come back, and the bytes that were sent."""
    if setting is None:
        return clip.events, 0
    key = (id(clip.events), setting)
    if key not in _DECODED:
        options = {"coder": "dense", **_options(clip)}
        if setting != "lossless":
            options["max_emd_us"] = int(setting.removesuffix(" us"))
        frames = eecvs.encode(clip.events, **options)
        _DECODED[key] = clip.events, eecvs.decode(frames), len(frames)
    _, events, size = _DECODED[key]
    return events, size
