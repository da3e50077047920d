"""Recordings and events that the tests share."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import eecvs

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared" / "data"
SENSOR = (64, 48)


def pytest_report_header() -> str:
    if SHARED.is_dir():
        return f"recordings: {SHARED}"
    return f"skipped: tests of recordings: there is no {SHARED}"


def random_events(
    count: int = 20_000, seed: int = 43, size: tuple[int, int] = SENSOR
) -> np.ndarray[Any, Any]:
    """Events in the order of time, some of which share a time, a pixel or both."""
    random = np.random.default_rng(seed)
    events = np.zeros(count, eecvs.DTYPES["eecvs"])
    events["t"] = np.sort(1_000_000 + random.integers(0, 4 * count, count))
    events["x"] = random.integers(0, size[0], count)
    events["y"] = random.integers(0, size[1], count)
    events["p"] = random.integers(0, 2, count)
    return events


def same(a: Any, b: Any) -> bool:
    """Whether events are equal in every field, whatever their layouts."""
    names = [("t", "timestamp"), ("x",), ("y",), ("p", "polarity")]

    def column(events: Any, of: tuple[str, ...]) -> Any:
        return np.asarray(events[next(name for name in of if name in events.dtype.fields)], np.int64)

    return len(a) == len(b) and all(np.array_equal(column(a, n), column(b, n)) for n in names)


@pytest.fixture(scope="session")
def events() -> np.ndarray[Any, Any]:
    return random_events()


@pytest.fixture
def recording(tmp_path: Path, events: np.ndarray[Any, Any]) -> eecvs.Recording:
    path = tmp_path / "a.raw"
    eecvs.write(path, events, sensor=SENSOR)
    return eecvs.open(path)


@pytest.fixture
def tonic(monkeypatch: pytest.MonkeyPatch) -> Any:
    """tonic without the packages that its data sets need, which nothing here uses."""
    pytest.importorskip("scipy")
    for name in ["importRosbag", "importRosbag.importRosbag", "librosa", "loris"]:
        if name.split(".")[0] in sys.modules or importlib.util.find_spec(name) is None:
            module: Any = ModuleType(name)
            module.importRosbag = None
            monkeypatch.setitem(sys.modules, name, module)
    pytest.importorskip("tonic", exc_type=ImportError)
    import tonic
    import tonic.functional
    import tonic.slicers
    import tonic.transforms

    return tonic


@pytest.fixture(scope="session")
def reference() -> dict[str, Any]:
    """What is known of the shared recordings, by file."""
    if not SHARED.is_dir():
        pytest.skip(f"there is no {SHARED}")
    found: dict[str, Any] = json.loads((SHARED / "REFERENCE.json").read_text())
    return found
