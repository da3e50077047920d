"""Events go into and out of other packages unchanged; each package is wanted, none is a must."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, same

import eecvs


def test_faery(tmp_path: Path, events: Any) -> None:
    faery = pytest.importorskip("faery")
    assert eecvs.DTYPES["faery"] == faery.EVENTS_DTYPE
    eecvs.write(tmp_path / "a.raw", events, sensor=SENSOR)
    theirs = faery.events_stream_from_file(tmp_path / "a.raw").to_array()
    ours = eecvs.open(tmp_path / "a.raw", dtype="faery").read()
    assert ours.dtype == theirs.dtype and np.array_equal(ours, theirs)
    stream = faery.events_stream_from_array(ours, SENSOR)
    stream.to_file(tmp_path / "b.aedat4")
    assert same(eecvs.open(tmp_path / "b.aedat4").read(), events)
    assert eecvs.encode(theirs, sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)


def test_expelliarmus(tmp_path: Path, events: Any) -> None:
    expelliarmus = pytest.importorskip("expelliarmus")
    wizard = expelliarmus.Wizard(encoding="dat")
    eecvs.write(tmp_path / "a.dat", events, sensor=SENSOR)
    theirs = wizard.read(tmp_path / "a.dat")
    ours = eecvs.open(tmp_path / "a.dat", dtype="expelliarmus").read()
    assert ours.dtype == theirs.dtype and np.array_equal(ours, theirs)
    wizard.save(tmp_path / "b.dat", ours)
    assert same(eecvs.open(tmp_path / "b.dat", width=64, height=48).read(), events)


def test_tonic(tonic: Any, events: Any, recording: eecvs.Recording) -> None:
    ours = eecvs.open(recording.path, dtype="tonic").read()
    cropped = tonic.transforms.Compose([tonic.transforms.TimeJitter(std=0)])(ours)
    assert same(cropped, events)
    assert eecvs.encode(cropped, sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)
    slicer = tonic.slicers.SliceByTime(10_000)
    theirs, _ = slicer.slice(ours, None)
    for a, b in zip(theirs, recording.by_time(10_000)):
        assert same(a, b)


def test_dv_processing(events: Any, recording: eecvs.Recording) -> None:
    dv = pytest.importorskip("dv_processing")
    store = dv.EventStore()
    for t, x, y, p in events[:500].tolist():
        store.push_back(t, x, y, p)
    theirs = store.numpy()
    ours = eecvs.open(recording.path, dtype="dv").read()[:500]
    assert ours.dtype == theirs.dtype and np.array_equal(ours, theirs)
    assert eecvs.encode(theirs, sensor=SENSOR) == eecvs.encode(events[:500], sensor=SENSOR)


def test_evlib(tmp_path: Path, events: Any) -> None:
    evlib = pytest.importorskip("evlib")
    eecvs.write(tmp_path / "a.raw", events, sensor=SENSOR)
    frame = evlib.load_events(str(tmp_path / "a.raw")).collect()
    table = {
        "t": frame["t"].dt.total_microseconds().to_numpy(),
        "x": frame["x"].to_numpy(),
        "y": frame["y"].to_numpy(),
        "p": frame["polarity"].to_numpy(),
    }
    assert eecvs.encode(table, sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)


def test_metavision_s_documented_layout(recording: eecvs.Recording, events: Any) -> None:
    """EventCD: x and y uint16, p int16, t int64, in 16 bytes."""
    ours = eecvs.open(recording.path, dtype="metavision").read()
    assert ours.dtype.names == ("x", "y", "p", "t")
    assert [ours.dtype[name].str for name in ours.dtype.names] == ["<u2", "<u2", "<i2", "<i8"]
    assert [ours.dtype.fields[name][1] for name in ours.dtype.names] == [0, 2, 4, 8]
    assert ours.dtype.itemsize == 16 and same(ours, events)


def test_h5py(tmp_path: Path, events: Any) -> None:
    h5py = pytest.importorskip("h5py")
    eecvs.write(tmp_path / "a.h5", events, sensor=SENSOR)
    with h5py.File(tmp_path / "a.h5") as file:
        table = {name: file["events"][name][:] for name in "txyp"}
        table["t"] += file["t_offset"][()]
    assert eecvs.encode(table, sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)
