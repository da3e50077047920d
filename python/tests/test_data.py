"""Recordings as data sets."""

from __future__ import annotations

import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, same

import eecvs
from eecvs.data import Windows


@pytest.fixture
def path(tmp_path: Path, events: Any) -> Path:
    path = tmp_path / "a.eecvs"
    eecvs.write(path, events, sensor=SENSOR, window_us=5000)
    return path


def test_windows_hold_every_event_once(path: Path, events: Any) -> None:
    data = Windows(path, 7000)
    assert len(data) == -(-(int(events["t"][-1]) + 1 - int(events["t"][0])) // 7000)
    found = [data[i] for i in range(len(data))]
    assert same(np.sort(np.concatenate(found)), np.sort(events))
    for i, window in enumerate(found):
        start, end = data.times(i)
        assert ((window["t"] >= start) & (window["t"] < end)).all()
        assert same(data.events(i), window)
    assert same(data[-1], found[-1])
    with pytest.raises(IndexError):
        data[len(data)]
    assert len(list(data)) == len(data)  # type: ignore[call-overload]


def test_windows_become_arrays(path: Path, events: Any) -> None:
    data = Windows(path, 7000, partial(eecvs.voxel, bins=3), start_us=1_000_000, end_us=1_090_000)
    assert len(data) == 13
    t = events["t"]
    for i in range(len(data)):
        start, end = data.times(i)
        wanted = eecvs.voxel(events[(t >= start) & (t < end)], 3, sensor=SENSOR, t0_us=start, t1_us=end)
        assert np.allclose(data[i], wanted, atol=1e-5)


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_workers_read_for_themselves(path: Path, method: str) -> None:
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"there is no {method} here")
    data = Windows(path, 7000, partial(eecvs.counts, bins=2))
    wanted = [data[i] for i in range(len(data))]
    with ProcessPoolExecutor(2, multiprocessing.get_context(method)) as pool:
        found = list(pool.map(data.__getitem__, range(len(data))))
    assert all(np.array_equal(a, b) for a, b in zip(found, wanted))
    assert len(pickle.loads(pickle.dumps(data))) == len(data)


def test_no_windows(tmp_path: Path, path: Path, events: Any) -> None:
    eecvs.write(tmp_path / "b.eecvs", events[:0], sensor=SENSOR)
    assert len(Windows(tmp_path / "b.eecvs", 10)) == 0
    for wrong in [{"us": 0}, {"us": 5, "start_us": 9, "end_us": 3}]:
        with pytest.raises(ValueError):
            Windows(path, **wrong)  # type: ignore[arg-type]


def test_parts_are_those_of_the_whole_in_any_order(path: Path, events: Any) -> None:
    """One reader gives one part after the other: none is of another's times."""
    recording = eecvs.open(path)
    whole, t = recording.read(), recording.read()["t"]
    random = np.random.default_rng(7)
    first, last = int(t[0]), int(t[-1]) + 2
    for _ in range(60):
        start, end = np.sort(random.integers(first - 5000, last + 5000, 2))
        for times in (slice(start, end), slice(None, end), slice(start, None), slice(end, start), slice(0, start)):
            low, high = times.start or 0, np.inf if times.stop is None else times.stop
            assert same(recording.time[times], whole[(t >= low) & (t < high)])
    recording.close()
    with pytest.raises(ValueError, match="closed"):
        recording.time[first:last]


def test_parts_are_read_by_threads_at_once(path: Path, events: Any) -> None:
    data = Windows(path, 7000)
    wanted = [data[i] for i in range(len(data))]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(data.__getitem__, list(range(len(data))) * 5))
    assert all(same(a, b) for a, b in zip(found, wanted * 5))


def test_a_damaged_part_is_so_every_time(tmp_path: Path, events: Any) -> None:
    eecvs.write(tmp_path / "a.eecvs", events, sensor=SENSOR, window_us=5000)
    content = bytearray((tmp_path / "a.eecvs").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "b.eecvs").write_bytes(content)
    damaged = eecvs.open(tmp_path / "b.eecvs")
    t = events["t"]
    end = int(t[-1]) + 1
    for _ in range(3):
        assert same(np.sort(damaged.time[: int(t[5000])]), np.sort(events[t < t[5000]]))
        with pytest.raises(eecvs.DamagedError):
            damaged.time[int(t[100]) : end]
