"""Whole numbers of every function: what is none, or out of range, is refused by the argument's name and range."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR

import eecvs
from eecvs.data import Windows

Use = Callable[[Any, eecvs.Recording, Any], Any]

#: By the argument's name: a use of it, and the range that its refusal states.
USES: dict[str, tuple[Use, str]] = {
    "width": (lambda n, r, e: eecvs.open(r.path, width=n, height=4), "1 to 2048"),  # type: ignore[arg-type]
    "height": (lambda n, r, e: eecvs.open(r.path, width=4, height=n), "1 to 2048"),  # type: ignore[arg-type]
    "max_events_per_window": (lambda n, r, e: eecvs.Decoder(max_events_per_window=n), "0 to 4294967295"),
    "max_work_per_window": (lambda n, r, e: eecvs.Decoder(max_work_per_window=n), "0 to 4294967295"),
    "us": (lambda n, r, e: r.by_time(n), "1 to 18446744073709551615"),
    "origin_us": (lambda n, r, e: r.by_time(1000, origin_us=n), "0 to 18446744073709551615"),
    "n": (lambda n, r, e: r.by_count(n), "1 to"),
    "start": (lambda n, r, e: r.time[n:5], "0 to 18446744073709551615"),
    "stop": (lambda n, r, e: r.time[:n], "0 to 18446744073709551615"),
    "bins": (lambda n, r, e: eecvs.voxel(e, n, sensor=SENSOR), "1 to 4096"),
    "k": (lambda n, r, e: eecvs.tore(e, n, sensor=SENSOR), "1 to 4096"),
    "most": (lambda n, r, e: eecvs.counts(e, most=n, sensor=SENSOR), "1 to 255"),
    "t0_us": (lambda n, r, e: eecvs.voxel(e, 2, sensor=SENSOR, t0_us=n), "0 to"),
    "t1_us": (lambda n, r, e: eecvs.counts(e, 2, sensor=SENSOR, t1_us=n), "0 to"),
    "t_us": (lambda n, r, e: eecvs.tore(e, sensor=SENSOR, t_us=n), "0 to"),
    "seed": (lambda n, r, e: eecvs.emulate("motorcycle", seed=n), "0 to 18446744073709551615"),
    "duration_us": (lambda n, r, e: eecvs.emulate("motorcycle", duration_us=n), "0 to"),
    "start_us": (lambda n, r, e: eecvs.emulate("motorcycle", start_us=n), "0 to"),
    "model": (lambda n, r, e: eecvs.emulate("motorcycle", model=n), "1 to 2"),
    "window_us": (lambda n, r, e: eecvs.compare(r, r, window_us=n), "1 to"),
    "clip": (lambda n, r, e: eecvs.picture(e, sensor=SENSOR, clip=n), "1 to 4294967295"),
    "upscale": (lambda n, r, e: eecvs.picture(e, sensor=SENSOR, upscale=n), "1 to 64"),
    "us ": (lambda n, r, e: Windows(r.path, n), "1 to 9223372036854775807"),  # type: ignore[arg-type]
    "end_us": (lambda n, r, e: Windows(r.path, 9, end_us=n), "0 to"),  # type: ignore[arg-type]
}
if hasattr(eecvs, "capture"):
    USES["max_events"] = (lambda n, r, e: eecvs.capture(f"sim:davis346:{r.path}", max_events=n), "0 to")
    USES["queue_mib"] = (lambda n, r, e: eecvs.capture(f"sim:davis346:{r.path}", queue_mib=n), "1 to 4096")

OPTIONS = {
    "time_tolerance_us": "0 to 4294967295",
    "bins": "0 to 65535",
    "max_emd_us": "1 to 4294967295",
    "effort": "0 to 255",
    "key_windows": "0 to 65535",
    "key_us": "1 to",
    "bytes_per_second": "1 to",
    "m": "0 to 255",
    "grid": "0 to 65535",
    "step_log2": "-128 to 127",
    "window_us": "1 to",
    "origin_us": "0 to",
    "window_events": "1 to",
    "frame_bytes": "to",
    "reorder_us": "0 to",
    "threads": "1 to 1024",
}


def test_every_whole_number_of_the_encoder_is_here() -> None:
    of_ints = {name for name, kind in eecvs.EncodeOptions.__annotations__.items() if "int" in str(kind) and "tuple" not in str(kind)}
    assert of_ints == set(OPTIONS)


@pytest.mark.parametrize("name", USES)
def test_arguments(recording: eecvs.Recording, events: Any, name: str) -> None:
    use, wanted = USES[name]
    for wrong, shown in ((-1, "-1"), (1 << 200, "a number of 201 bits"), (-(10**10000), "a number of 33220 bits")):
        with pytest.raises(ValueError, match=f"^{name.strip()} is {shown}: it must be {wanted}"):
            use(wrong, recording, events)
    for none in (True, False, np.True_, 1.5, "2", [3]):
        with pytest.raises(TypeError, match=f"^{name.strip()} is .*: it must be a whole number"):
            use(none, recording, events)


@pytest.mark.parametrize("name", OPTIONS)
def test_options(events: Any, name: str) -> None:
    for wrong, shown in ((-129, "-129"), (1 << 200, "a number of 201 bits")):
        with pytest.raises(ValueError, match=f"^{name}: {shown}: it must be .*{OPTIONS[name]}"):
            eecvs.encode(events, sensor=SENSOR, **{name: wrong})  # type: ignore[arg-type]
    for none in (True, np.False_, 1.5):
        with pytest.raises(TypeError, match=f"^{name}: .*: it must be a whole number"):
            eecvs.Encoder(SENSOR, **{name: none})  # type: ignore[arg-type]


def test_places_and_sizes(events: Any) -> None:
    for region, message in (((0, 0, 0, 5), "the width is 0"), ((-1, 0, 5, 5), "x is -1"), ((0, True, 5, 5), "y is True")):
        with pytest.raises((TypeError, ValueError), match=f"^region: {message}: it must be"):
            eecvs.encode(events, sensor=SENSOR, region=region)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="^hot_pixels: y is -2: it must be 0 to 2047"):
        eecvs.encode(events, sensor=SENSOR, hot_pixels=[(1, -2)])
    with pytest.raises(TypeError, match="^the sensor's width is True"):
        eecvs.voxel(events, 2, sensor=(True, 3))
    with pytest.raises(ValueError, match="^the sensor's height is a number of 201 bits"):
        eecvs.voxel(events, 2, sensor=(3, 1 << 200))
    with pytest.raises(ValueError, match="^time_offset_us is 1180591620717411303424: it must be -9223372036854775808 to"):
        eecvs.open("a.raw", time_offset_us=1 << 70)


def test_what_is_an_index_is_a_number(recording: eecvs.Recording, events: Any, tmp_path: Path) -> None:
    right = eecvs.voxel(events, 2, sensor=SENSOR)
    for kind in (np.int8, np.uint64, np.array):
        assert np.array_equal(eecvs.voxel(events, kind(2), sensor=(kind(64), kind(48))), right)
    first = int(events["t"][0])
    assert len(recording.time[np.int64(first) : np.uint64(first + 1)])  # type: ignore[misc]
    assert eecvs.encode(events, sensor=SENSOR, threads=np.int64(1)) == eecvs.encode(events, sensor=SENSOR)  # type: ignore[arg-type]


def test_bools_are_no_numbers_of_any_kind(events: Any) -> None:
    with pytest.raises(TypeError, match="^tau_us is True: it must be a number"):
        eecvs.time_surface(events, True, sensor=SENSOR)
    with pytest.raises(TypeError, match="^max_error: True: it must be a number"):
        eecvs.encode(events, sensor=SENSOR, max_error=True)
