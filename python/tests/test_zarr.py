"""Chunks of events in Zarr, by its codec."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import random_events

import eecvs

numcodecs = pytest.importorskip("numcodecs")

from eecvs.zarr import Events  # noqa: E402


@pytest.mark.parametrize("name", list(eecvs.DTYPES))
@pytest.mark.parametrize("effort", [0, 1])
def test_rows_come_back_bit_for_bit(events: Any, name: str, effort: int) -> None:
    dtype = eecvs.DTYPES[name]
    rows = np.zeros(len(events), dtype)
    rows["timestamp" if name == "dv" else "t"] = events["t"]
    rows["x"], rows["y"] = events["x"], events["y"]
    rows["polarity" if name == "dv" else "p"] = events["p"]
    codec = Events.of(dtype, effort, gaps=True)
    packed = codec.encode(rows)
    assert len(packed) * 3 < rows.nbytes
    again = numcodecs.get_codec(codec.get_config())
    assert np.frombuffer(again.decode(packed), dtype).tobytes() == rows.tobytes()
    out = np.empty_like(rows)
    again.decode(packed, out)
    assert np.array_equal(out, rows)
    # Neither their order nor what is no event is lost.
    odd = rows[::-1].copy()
    odd["x"][::7] = 5000
    assert again.decode(again.encode(odd)) == odd.tobytes()
    assert bytes(again.decode(again.encode(rows[:0]))) == b""


def test_damage_and_wrong_layouts(events: Any) -> None:
    codec = Events.of(events.dtype, gaps=True)
    packed = bytearray(codec.encode(events))
    packed[len(packed) // 2] ^= 1
    with pytest.raises(eecvs.DamagedError):
        codec.decode(bytes(packed))
    with pytest.raises(ValueError, match="memory"):
        Events.of(events.dtype, bytes_max=1000, gaps=True).decode(codec.encode(events))
    with pytest.raises(ValueError, match="layout"):
        Events.of(events.dtype).encode(events)
    with pytest.raises(ValueError):
        Events([16, 0, 8, 8, 2, 9, 2, 12, 1])
    with pytest.raises(ValueError):
        Events.of(events.dtype, effort=4)
    for dtype in ("<i8", [("t", "<f8"), ("x", "u2"), ("y", "u2"), ("p", "?")], [("t", ">i8"), ("x", "u2"), ("y", "u2"), ("p", "?")]):
        with pytest.raises(ValueError, match="field t"):
            Events.of(dtype)
    with pytest.raises(ValueError, match="whole rows"):
        codec.encode(b"seven b")


def test_zarr_reads_and_writes_with_it(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    events = random_events(50_000)
    path = str(tmp_path / "events.zarr")
    array = zarr.create_array(
        path, shape=events.shape, chunks=(1 << 14,), dtype=events.dtype, compressors=Events.of(events.dtype), zarr_format=2
    )
    array[:] = events
    stored = sum(file.stat().st_size for file in Path(path).rglob("*") if file.is_file())
    assert stored * 3 < events.nbytes
    again = zarr.open_array(path, mode="r")
    assert np.array_equal(again[:], events) and np.array_equal(again[30_000:30_100], events[30_000:30_100])
