"""The codec: exact, within errors, in portions, and from damaged bytes."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, SHARED, random_events, same

import eecvs

LOSSLESS: list[dict[str, Any]] = [
    {}, {"coder": "quick"}, {"coder": "dense"}, {"coder": "dense", "effort": 1}, {"keep_order": True},
    {"window_us": 1000}, {"coder": "dense", "key_us": 100_000}, {"threads": 1}, {"auto_window": True},
    {"window_events": 100}, {"frame_bytes": 1024}, {"every_window": True, "origin_us": 500}, {"reorder_us": 0},
]  # fmt: skip


def decode(frames: bytes, portion: int = 1 << 20, **options: Any) -> tuple[Any, eecvs.Decoder, list[eecvs.Window]]:
    decoder = eecvs.Decoder(**options)
    windows: list[eecvs.Window] = []
    for at in range(0, len(frames), portion):
        windows += decoder.push(frames[at : at + portion])
    windows += decoder.finish()
    found = [window.events for window in windows]
    return np.concatenate(found) if found else np.zeros(0, eecvs.DTYPES["eecvs"]), decoder, windows


@pytest.mark.parametrize("options", LOSSLESS)
def test_lossless(tmp_path: Path, events: Any, options: Any) -> None:
    frames = eecvs.encode(events, sensor=SENSOR, **options)
    found, decoder, windows = decode(frames)
    assert same(np.sort(found), np.sort(events))
    assert decoder.sensor == SENSOR
    assert all(window.is_exact for window in windows)
    path = tmp_path / "a.eecvs"
    path.write_bytes(frames)
    assert same(eecvs.open(path).read(), found)
    if options.get("keep_order") or options.get("coder") == "quick":
        assert same(found, events)


def test_frames_do_not_depend_on_threads_or_on_portions(events: Any) -> None:
    for options in LOSSLESS[:7]:
        whole = eecvs.encode(events, sensor=SENSOR, **options)
        assert whole == eecvs.encode(events, sensor=SENSOR, threads=3, **options)
        assert whole == eecvs.encode(iter([events[:9], events[9:]]), sensor=SENSOR, **options)
        for portion in [1009, 20_000]:
            encoder = eecvs.Encoder(SENSOR, **options)
            frames = b"".join(encoder.push(events[at : at + portion]) for at in range(0, len(events), portion))
            frames += encoder.finish()
            assert frames == whole, (options, portion)
            assert encoder.summary["events_encoded"] == len(events)
            assert encoder.summary["bytes_out"] == len(whole)


def test_an_encoder_looks_for_scans_as_encode_does() -> None:
    path = SHARED / "dvxl_person_moderate" / "data_sample.aedat4"
    if not path.exists():
        pytest.skip(f"there is no {path}")
    recording = eecvs.open(path)
    whole = eecvs.encode(recording, coder="dense")
    encoder = eecvs.Encoder(recording.sensor, coder="dense")
    frames = b"".join(encoder.push(batch) for batch in recording) + encoder.finish()
    assert frames == whole
    assert len(whole) < len(eecvs.encode(recording, coder="dense", scans="off"))


def test_bytes_may_be_cut_anywhere(events: Any) -> None:
    frames = eecvs.encode(events[:3000], sensor=SENSOR, window_us=2000)
    whole, _, windows = decode(frames)
    for portion in [1, 7, 1000]:
        found, _, again = decode(frames, portion)
        assert same(found, whole) and len(again) == len(windows)
    for buffer in [bytearray(frames), memoryview(frames), np.frombuffer(frames, np.uint8)]:
        decoder = eecvs.Decoder()
        assert len(decoder.push(buffer) + decoder.finish()) == len(windows)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"time_tolerance_us": 50}, 50),
        ({"coder": "dense", "time_tolerance_us": 1000}, 1000),
        ({"bins": 8}, 32_768 // 8 + 1),
        ({"max_emd_us": 100}, 32_768),
        ({"max_nmse": 0.01}, 32_768),
    ],
)
def test_times_are_within_their_error(events: Any, options: Any, error: int) -> None:
    frames = eecvs.encode(events, sensor=SENSOR, **options)
    assert len(frames) < len(eecvs.encode(events, sensor=SENSOR))
    found, _, windows = decode(frames)
    assert len(found) == len(events)
    order = ["x", "y", "p", "t"]
    a, b = np.sort(found, order=order), np.sort(events, order=order)
    for name in "xyp":
        assert np.array_equal(a[name], b[name])
    assert np.abs(a["t"] - b["t"]).max() <= 2 * error
    assert not all(window.is_exact for window in windows)


def test_coefficients(events: Any) -> None:
    events = events[:2000]
    frames = eecvs.encode(events, sensor=SENSOR, mode="transform", transform="dct", m=16, step_log2=-8)
    found, decoder, windows = decode(frames)
    assert len(found) == len(events)
    confidences = decoder.losses
    assert confidences["pixels_exact"] + confidences["pixels_consistent"] + confidences["pixels_approximate"] > 0
    lossless = decode(eecvs.encode(events, sensor=SENSOR, transform="dct", m=16, step_log2=-8))[2]
    assert (windows[0].transform, windows[0].m) == ("dct", 16)
    for of_coefficients, of_events in zip(windows, lossless):
        a, b = of_coefficients.coefficients(), of_events.coefficients()
        assert a.shape == (16, 48, 64) and a.dtype == np.float32
        assert np.array_equal(a, b)


def test_volumes_of_windows_are_exact(events: Any) -> None:
    for window in decode(eecvs.encode(events, sensor=SENSOR))[2]:
        t, d = window.events["t"] - window.t0_us, window.duration_us
        wanted = np.zeros((5, 48, 64))
        np.add.at(wanted, (t * 5 // d, window.events["y"], window.events["x"]), window.events["p"] * 2.0 - 1)
        assert np.array_equal(window.voxel(5), wanted)
        split = window.voxel(5, polarity="split")
        assert np.array_equal(split[:5] - split[5:], wanted)
        scaled = window.voxel(5, normalise=True)
        assert abs(scaled[wanted != 0].mean()) < 1e-5
        direct = eecvs.voxel(window, 5, weights="nearest", t0_us=window.t0_us, t1_us=window.t0_us + d)
        assert np.array_equal(direct, wanted)
        bilinear = eecvs.voxel(window, 5, t0_us=window.t0_us, t1_us=window.t0_us + d)
        assert np.allclose(bilinear, window.voxel(5, weights="bilinear"), atol=1e-5)
        assert len(window) == len(window.events)


def test_random_access(tmp_path: Path) -> None:
    events = random_events(300_000)
    path = tmp_path / "a.eecvs"
    eecvs.write(path, events, sensor=SENSOR, window_us=5000)
    recording = eecvs.open(path)
    t = events["t"]
    for start in range(int(t[0]), int(t[-1]), 150_007):
        wanted = events[(t >= start) & (t < start + 3001)]
        assert same(np.sort(recording.time[start : start + 3001]), np.sort(wanted))
    # Only a few windows of it are read.
    _ = recording.time[0:1]
    assert recording.info.format == "eecvs"


def test_filters_and_hot_pixels(tmp_path: Path, events: Any) -> None:
    hot = [(int(events["x"][0]), int(events["y"][0])), (1, 1)]
    named = tmp_path / "hot.txt"
    named.write_text("".join(f"{x},{y}\n" for x, y in hot))
    is_hot = np.zeros(len(events), bool)
    for x, y in hot:
        is_hot |= (events["x"] == x) & (events["y"] == y)
    for pixels in [hot, named, str(named)]:
        frames = eecvs.encode(events, sensor=SENSOR, hot_pixels=pixels)
        with pytest.warns(eecvs.LossWarning, match="filtered"):
            found = decode(frames)[0]
        assert same(np.sort(found), np.sort(events[~is_hot]))
    with pytest.warns(eecvs.LossWarning):
        found = decode(eecvs.encode(events, sensor=SENSOR, region=(10, 5, 20, 9)))[0]
    assert found["x"].min() == 10 and found["x"].max() == 29 and found["y"].max() == 13
    with pytest.raises(eecvs.EecvsError, match="outside"):
        eecvs.encode(events, sensor=SENSOR, region=(60, 0, 5, 5))


def test_budgets_are_kept_and_told(events: Any) -> None:
    frames = eecvs.encode(events, sensor=SENSOR, bytes_per_second=60_000)
    seconds = (events["t"][-1] - events["t"][0]) / 1e6
    assert len(frames) < 60_000 * (seconds + 1)
    with pytest.warns(eecvs.LossWarning, match="rate control"):
        found, decoder, _ = decode(frames)
    assert decoder.losses["events_thinned"] == len(events) - len(found) > 0


def test_late_events_are_refused_unless_loss_is_allowed(events: Any) -> None:
    late = np.concatenate([events[5000:5003], events[:5000]])
    late["t"][:3] = events["t"][4999] - 100
    options: Any = {"reorder_us": 5, "window_us": 20_000}
    order = np.concatenate([events[:5000], events[2000:2001]])
    try:
        eecvs.encode(order, sensor=SENSOR, **options)
    except eecvs.RefusedError as error:
        assert "reorder_us=" in str(error) and "allow_loss=" in str(error)
        with pytest.warns(eecvs.LossWarning):
            eecvs.encode(order, sensor=SENSOR, allow_loss=True, **options)
    assert same(np.sort(decode(eecvs.encode(order, sensor=SENSOR, sort=True))[0]), np.sort(order))


@pytest.mark.parametrize(
    ("options", "error", "word"),
    [
        ({"what": 1}, TypeError, "what"),
        ({"coder": "slow"}, ValueError, "quick"),
        ({"m": 0}, ValueError, "^m 0: it must be 1 to 64"),
        ({"m": "x"}, TypeError, "m:"),
        ({"m": 300}, ValueError, "m:"),
        ({"effort": 2}, ValueError, "effort="),
        ({"effort": 9, "coder": "dense"}, ValueError, "effort="),
        ({"bins": 3, "time_tolerance_us": 4}, ValueError, "bins="),
        ({"coder": "quick", "bins": 3}, ValueError, "coder=quick"),
        ({"key_us": 5, "key_windows": 6}, ValueError, "key_us="),
        ({"window_us": 0}, ValueError, "window_us"),
        ({"mode": "transform", "keep_order": True}, ValueError, "keep_order="),
        ({"max_nmse": 2.0}, ValueError, "max_nmse="),
        ({"max_error": 1e-9}, eecvs.EecvsError, "max_error="),
        ({"hot_pixels": [(999, 0)]}, eecvs.EecvsError, "999,0"),
        ({"hot_pixels": "/none"}, FileNotFoundError, "/none"),
        ({"thresholds": "/none"}, FileNotFoundError, "/none"),
        ({"window_events": 0}, ValueError, "window_events"),
        ({"frame_bytes": 1}, ValueError, "frame_bytes"),
        ({"threads": 0}, ValueError, "threads"),
        ({"bytes_per_second": 1}, ValueError, "too small"),
    ],
)
def test_wrong_options_are_refused(events: Any, options: Any, error: Any, word: str) -> None:
    with pytest.raises(error, match=word):
        eecvs.encode(events, sensor=SENSOR, **options)
    if "threads" not in options:
        with pytest.raises(error, match=word):
            eecvs.Encoder(SENSOR, **options)


def test_none_is_the_default(events: Any) -> None:
    nothing: Any = dict.fromkeys(["bins", "coder", "key_us", "hot_pixels", "thresholds", "threads", "m"])
    assert eecvs.encode(events, sensor=SENSOR, **nothing) == eecvs.encode(events, sensor=SENSOR)


def test_an_encoder_ends_once(events: Any) -> None:
    encoder = eecvs.Encoder(SENSOR)
    encoder.push(events)
    encoder.finish()
    assert encoder.finish() == b""
    with pytest.raises(eecvs.RefusedError, match="finished"):
        encoder.push(events)
    with pytest.raises(ValueError, match="auto_window="):
        eecvs.Encoder(SENSOR, auto_window=True)
    nothing = eecvs.Encoder(SENSOR)
    frames = nothing.push(events[:0]) + nothing.finish()
    assert frames == eecvs.encode(events[:0], sensor=SENSOR)
    assert len(decode(frames)[0]) == 0


def test_damage_is_counted_and_told(tmp_path: Path, events: Any) -> None:
    frames = bytearray(eecvs.encode(events, sensor=SENSOR, window_us=2000))
    frames[len(frames) // 2] ^= 0x55
    decoder = eecvs.Decoder()
    windows = decoder.push(bytes(frames))
    with pytest.warns(eecvs.LossWarning, match="damaged bytes"):
        windows += decoder.finish()
    assert decoder.losses["damaged_bytes"] > 0 and decoder.losses["frames_lost"] >= 1
    found = sum(map(len, windows))
    assert 0 < found < len(events)
    path = tmp_path / "a.eecvs"
    path.write_bytes(frames)
    with pytest.raises(eecvs.DamagedError) as error:
        eecvs.open(path).read()
    assert error.value.offset is not None and len(error.value.events) == found  # type: ignore[attr-defined]
    with pytest.raises(eecvs.DamagedError):
        empty = eecvs.Decoder()
        empty.push(b"not a frame")
        empty.finish()
    with pytest.raises(TypeError):
        eecvs.Decoder().push(5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="finished"):
        decoder.push(b"")


def test_layouts_of_windows(events: Any) -> None:
    frames = eecvs.encode(events, sensor=SENSOR)
    found, _, _ = decode(frames, dtype="tonic")
    assert found.dtype == eecvs.DTYPES["tonic"]
    with pytest.raises(ValueError):
        eecvs.Decoder(events="guess")  # type: ignore[arg-type]


def test_the_command_writes_the_same_bytes(tmp_path: Path, recording: eecvs.Recording) -> None:
    command = os.environ.get("EECVS_COMMAND")
    if not command:
        pytest.skip("EECVS_COMMAND names no command eecvs")
    for flags, options in [
        ([], {}),
        (["--coder", "dense", "--time-tolerance-us", "30"], {"coder": "dense", "time_tolerance_us": 30}),
        (["--mode", "transform", "--transform", "best", "-m", "8"], {"mode": "transform", "transform": "best", "m": 8}),
        (["--auto-window", "--keep-order"], {"auto_window": True, "keep_order": True}),
    ]:
        out = tmp_path / "command.eecvs"
        subprocess.run([command, "encode", str(recording.path), "-o", str(out), "--overwrite", *flags], check=True)
        assert out.read_bytes() == eecvs.encode(recording, **options), flags  # type: ignore[arg-type]


def test_decode_is_the_inverse_of_encode(events: Any) -> None:
    frames = eecvs.encode(events, sensor=SENSOR, keep_order=True)
    assert same(eecvs.decode(frames), events)
    assert eecvs.decode(memoryview(frames), dtype="dv").dtype == eecvs.DTYPES["dv"]
    nothing = eecvs.decode(eecvs.encode(events[:0], sensor=SENSOR), dtype="tonic")
    assert len(nothing) == 0 and nothing.dtype == eecvs.DTYPES["tonic"]
    with pytest.raises(eecvs.DamagedError):
        eecvs.decode(b"no frames at all" * 100)
    with pytest.warns(eecvs.LossWarning):
        fewer = eecvs.decode(frames[: len(frames) // 2] + frames[len(frames) // 2 + 9 :])
    assert len(fewer) < len(events)
    with pytest.raises(ValueError):
        eecvs.decode(frames, dtype="none")
