"""Writing: what is given, what is refused, and that nothing is destroyed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, same

import eecvs


def columns(events: Any, **kinds: Any) -> dict[str, Any]:
    return {name: events[name].astype(kinds.get(name, events[name].dtype)) for name in "txyp"}


@pytest.mark.parametrize(
    "give",
    [
        lambda e: e,
        lambda e: e[::1],
        lambda e: columns(e),
        lambda e: columns(e, t=np.uint64, x=np.int64, y=np.int32, p=np.int8),
        lambda e: {"timestamp": e["t"], "x": e["x"], "y": e["y"], "polarity": e["p"].astype(np.int8) * 2 - 1},
        lambda e: {"t": e["t"].tolist(), "x": e["x"].tolist(), "y": e["y"].tolist(), "on": e["p"].tolist()},
        lambda e: columns(e, t=">i8", x=">u2"),
        lambda e: [e[:7000], e[7000:7000], e[7000:]],
        lambda e: (e[i : i + 999] for i in range(0, len(e), 999)),
    ],
)
def test_events_in_any_form(tmp_path: Path, events: Any, give: Any) -> None:
    path = tmp_path / "a.dat"
    eecvs.write(path, give(events), sensor=SENSOR)
    assert same(eecvs.open(path).read(), events)


def test_a_view_is_written_as_it_is(tmp_path: Path, events: Any) -> None:
    path = tmp_path / "a.dat"
    eecvs.write(path, events[::3], sensor=SENSOR)
    assert same(eecvs.open(path).read(), events[::3])
    eecvs.write(tmp_path / "b.dat", events[::-1][::-1], sensor=SENSOR)
    assert same(eecvs.open(tmp_path / "b.dat").read(), events)


def test_a_recording_is_converted(tmp_path: Path, recording: eecvs.Recording, events: Any) -> None:
    for ending in [".aedat4", ".parquet", ".eecvs"]:
        eecvs.write(tmp_path / ("b" + ending), recording)
        assert same(np.sort(eecvs.open(tmp_path / ("b" + ending)).read()), np.sort(events))
    eecvs.write(tmp_path / "c.h5", recording.columns())
    assert same(eecvs.open(tmp_path / "c.h5").read(), events)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"t": -1}, "event 5: the time -1 us"),
        ({"x": 2048}, "event 5: x is 2048"),
        ({"y": -3}, "event 5: y is -3"),
        ({"p": 2}, "event 5: the polarity is 2"),
    ],
)
def test_what_is_no_event_is_refused(tmp_path: Path, events: Any, change: Any, word: str) -> None:
    table = columns(events[:10], t=np.int64, x=np.int64, y=np.int64, p=np.int64)
    for name, value in change.items():
        table[name][5] = value
    for give in [lambda: eecvs.write(tmp_path / "a.dat", table, sensor=SENSOR), lambda: eecvs.encode(table, sensor=SENSOR)]:
        with pytest.raises(eecvs.RefusedError, match=word):
            give()
    assert list(tmp_path.iterdir()) == []


def test_wrong_kinds_are_refused(events: Any) -> None:
    with pytest.raises(TypeError, match="whole numbers"):
        eecvs.encode({**columns(events), "t": events["t"] / 1e6}, sensor=SENSOR)
    with pytest.raises(ValueError, match="equally many"):
        eecvs.encode({**columns(events), "x": events["x"][:5]}, sensor=SENSOR)
    with pytest.raises(ValueError, match="none is called"):
        eecvs.encode({"a": events["t"]}, sensor=SENSOR)
    with pytest.raises(ValueError, match="sensor="):
        eecvs.encode(events)
    with pytest.raises(TypeError):
        eecvs.encode(7, sensor=SENSOR)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        eecvs.encode("a.raw", sensor=SENSOR)
    with pytest.raises(eecvs.RefusedError, match="-1 and 0"):
        eecvs.encode({**columns(events), "p": np.arange(len(events)) % 3 - 1}, sensor=SENSOR)
    with pytest.raises(ValueError, match="1 to 2048"):
        eecvs.encode(events, sensor=(0, 5))


def test_events_outside_the_sensor_are_refused(tmp_path: Path, events: Any) -> None:
    with pytest.raises(eecvs.RefusedError):
        eecvs.write(tmp_path / "a.aedat4", events, sensor=(10, 10))
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_destroyed(tmp_path: Path, events: Any) -> None:
    path = tmp_path / "a.raw"
    eecvs.write(path, events, sensor=SENSOR)
    before = path.read_bytes()
    with pytest.raises(eecvs.RefusedError, match="overwrite="):
        eecvs.write(path, events[:5], sensor=SENSOR)
    with pytest.raises(eecvs.RefusedError, match="same file"):
        eecvs.write(path, eecvs.open(path), overwrite=True)

    def fails() -> Iterator[Any]:
        yield events[:5]
        raise KeyError("in the middle")

    for ending in ["raw", "eecvs"]:
        with pytest.raises(KeyError, match="in the middle"):
            eecvs.write(tmp_path / ("a." + ending), fails(), sensor=SENSOR, overwrite=True)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.raw"]
    eecvs.write(path, events[:5], sensor=SENSOR, overwrite=True)
    assert len(eecvs.open(path).read()) == 5
    with pytest.raises(eecvs.UnsupportedError):
        eecvs.write(tmp_path / "a.jpg", events, sensor=SENSOR)
    with pytest.raises(eecvs.EecvsError):
        eecvs.write(tmp_path / "none" / "a.raw", events, sensor=SENSOR)


def test_losses_are_asked_for_and_told(tmp_path: Path, events: Any) -> None:
    far = events.copy()
    far["t"][-100:] += 10_000_000
    path = tmp_path / "a.bin"
    with pytest.raises(eecvs.CannotHoldError, match="allow_loss="):
        eecvs.write(path, far, sensor=SENSOR)
    with pytest.warns(eecvs.LossWarning):
        written = eecvs.write(path, far, sensor=SENSOR, allow_loss=True)
    assert written.lost
    assert written.events_out == len(eecvs.open(path, width=64, height=48).read())


def test_damage_of_the_input(tmp_path: Path, recording: eecvs.Recording) -> None:
    cut = tmp_path / "cut.raw"
    cut.write_bytes(Path(recording.path).read_bytes()[:-1])
    for name in ["b.dat", "b.eecvs"]:
        with pytest.raises(eecvs.DamagedError):
            eecvs.write(tmp_path / name, eecvs.open(cut))
        assert not (tmp_path / name).exists()
        with pytest.warns(eecvs.LossWarning, match="everything before"):
            written = eecvs.write(tmp_path / name, eecvs.open(cut, damaged="keep"))
        assert written.events_out >= 19_900


def test_formats_by_name(tmp_path: Path, events: Any) -> None:
    path = tmp_path / "a.anything"
    eecvs.write(path, events, sensor=SENSOR, format="evt2")
    assert eecvs.open(path).format == "evt2"
    with pytest.raises(ValueError, match="evt2"):
        eecvs.write(path, events, sensor=SENSOR, format="evt9", overwrite=True)
    with pytest.raises(TypeError, match="coder"):
        eecvs.write(tmp_path / "b.raw", events, sensor=SENSOR, coder="dense")


def test_no_events(tmp_path: Path, events: Any) -> None:
    for ending in [".raw", ".dat", ".aedat4", ".npz", ".eecvs", ".parquet"]:
        path = tmp_path / ("a" + ending)
        eecvs.write(path, events[:0], sensor=SENSOR)
        recording = eecvs.open(path)
        assert len(recording.read()) == 0 and recording.sensor == SENSOR
        assert recording.read().dtype == events.dtype
        assert list(recording.by_time(10)) == [] and len(recording.columns()) == 0
    assert len(eecvs.open(tmp_path / "a.raw", dtype="tonic").read()) == 0
