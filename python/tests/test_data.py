"""Recordings as data sets."""

from __future__ import annotations

import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
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
