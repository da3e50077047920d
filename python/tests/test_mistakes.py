"""What callers get wrong: refused before anything is lost, with a message that names it."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, random_events, same

import eecvs
from eecvs.data import Windows

VOLUMES: list[Any] = [
    lambda events, **more: eecvs.voxel(events, 3, **more),
    lambda events, **more: eecvs.counts(events, 3, **more),
    lambda events, **more: eecvs.time_surface(events, 1e4, **more),
    lambda events, **more: eecvs.tore(events, 2, **more),
]


@pytest.mark.parametrize("make", VOLUMES)
def test_out_is_an_array_of_its_own_in_the_order_of_c(make: Any, events: Any) -> None:
    right = make(events, sensor=SENSOR)
    with pytest.raises(ValueError, match="contiguous"):
        make(events, sensor=SENSOR, out=np.empty(right.shape, right.dtype, order="F"))
    before = events.copy()
    shared = events.view(np.uint8)[: right.nbytes].view(right.dtype).reshape(right.shape)
    with pytest.raises(ValueError, match="shares memory"):
        make(events, sensor=SENSOR, out=shared)
    with pytest.raises(ValueError, match="shares memory"):
        make([events[::-2][::-1]], sensor=SENSOR, out=shared[np.newaxis])
    assert same(events, before)
    out = np.empty_like(right)
    assert make(events, sensor=SENSOR, out=out) is out and np.array_equal(out, right)
    with pytest.raises(ValueError, match="dtype of out"):
        make(events, sensor=SENSOR, out=np.empty(right.shape, np.float64))


def test_events_outside_of_the_sensor_are_refused(events: Any, tmp_path: Path) -> None:
    small = (40, 48)
    at = int(np.argmax(events["x"] >= 40))
    for use in (
        lambda: eecvs.encode(events, sensor=small),
        lambda: eecvs.Encoder(small).push(events),
        lambda: eecvs.write(tmp_path / "a.eecvs", events, sensor=small),
        lambda: eecvs.write(tmp_path / "a.raw", events, sensor=small),
        lambda: eecvs.compare(events, events, sensor=small),
        lambda: eecvs.picture(events, sensor=small),
    ):
        with pytest.raises(eecvs.RefusedError, match=rf"event {at} at .* outside the sensor \(40x48\)"):
            use()
    assert list(tmp_path.iterdir()) == []


def test_masks_are_refused(events: Any) -> None:
    masked = np.ma.array(events, mask=False)
    with pytest.raises(TypeError, match="masked"):
        eecvs.voxel(masked, 3, sensor=SENSOR)
    columns = {name: events[name] for name in "txyp"}
    columns["x"] = np.ma.array(events["x"], mask=False)
    with pytest.raises(TypeError, match="x is a masked array"):
        eecvs.encode(columns, sensor=SENSOR)


def test_sizes_are_any_pair(events: Any) -> None:
    right = eecvs.voxel(events, 2, sensor=SENSOR)
    for size in (list(SENSOR), np.array(SENSOR), eecvs.Sensor(*SENSOR)):
        assert np.array_equal(eecvs.voxel(events, 2, sensor=size), right)  # type: ignore[arg-type]
    for size, message in ((-1, 3), "-1 x 3"), ((2049, 3), "2049 x 3"), ("ab", "sensor"), ((1, 2, 3), "sensor"), (7, "sensor"):
        with pytest.raises((TypeError, ValueError), match=message):
            eecvs.voxel(events, 2, sensor=size)  # type: ignore[call-overload]


def test_what_has_a_sensor_need_not_be_told_it(recording: eecvs.Recording, events: Any) -> None:
    frames = eecvs.encode(recording)
    decoder = eecvs.Decoder()
    windows = decoder.push(frames) + decoder.finish()
    assert eecvs.voxel(windows, 2).shape == (len(windows), 2, 48, 64)
    assert len(eecvs.decode(eecvs.encode(windows))) == len(events)
    assert len(eecvs.decode(eecvs.encode(recording.by_count(1000)))) == len(events)
    with pytest.raises(TypeError, match=r"recording\.read\(\)"):
        eecvs.voxel(recording, 2)  # type: ignore[call-overload]


def test_windows_take_any_whole_index(tmp_path: Path) -> None:
    eecvs.write(tmp_path / "a.eecvs", random_events(50_000), sensor=SENSOR)
    data = Windows(tmp_path / "a.eecvs", 1000)
    for kind in (np.int8, np.uint8, np.int16, np.int64):
        assert data.times(kind(99)) == data.times(99)
    assert data.times(np.int8(-1)) == data.times(len(data) - 1)
    for wrong in (1.0, slice(0, 2), "1"):
        with pytest.raises(TypeError):
            data[wrong]  # type: ignore[index]
    with pytest.raises(TypeError):
        Windows(tmp_path / "a.eecvs", 1.5)  # type: ignore[arg-type]


def test_scenes_end_before_the_end_of_time() -> None:
    with pytest.raises(ValueError, match="2\\^63"):
        eecvs.emulate("motorcycle", start_us=2**63 - 1)


def test_threads_beyond_the_cores_cost_nothing(events: Any) -> None:
    frames = eecvs.encode(events, sensor=SENSOR)
    assert eecvs.encode(events, sensor=SENSOR, threads=1000) == frames


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.parametrize("part", [False, True])
def test_a_pipe_is_read_once(tmp_path: Path, events: Any, part: bool) -> None:
    first = int(events["t"][0])
    eecvs.write(tmp_path / "a.raw", events, sensor=SENSOR)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: pipe.write_bytes((tmp_path / "a.raw").read_bytes()))
    writer.start()
    recording = eecvs.open(pipe)
    assert same(recording.time[first:] if part else recording.read(), events)
    writer.join()
    for again in (recording.read, lambda: recording.info, lambda: recording.time[0:1], lambda: recording.by_count(3)):
        with pytest.raises(eecvs.RefusedError, match="a pipe can be read once"):
            again()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.parametrize(
    "work",
    [
        "eecvs.open(sys.argv[1])",
        "scene.info",
        "scene.time[10**10:10**11]",
        "scene.read()",
        "list(scene)",
        "eecvs.compare(scene, scene)",
        "list(scene.by_time(10**9))",
    ],
)
def test_work_ends_at_an_interrupt(tmp_path: Path, work: str) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    code = f"""
import eecvs, os, signal, sys, threading
# Where the tests run in the background, it is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
scene = eecvs.emulate("outdoor-dark", duration_us=10**11, sensor=(16, 16))
threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
try:
    {work}
except KeyboardInterrupt:
    os._exit(9)
"""
    ended = subprocess.run([sys.executable, "-c", code, str(pipe)], timeout=60)
    assert ended.returncode == 9


def replace(path: Path, events: Any) -> None:
    eecvs.write(path, events, sensor=SENSOR, overwrite=True)


def overwrite(path: Path, events: Any) -> None:
    eecvs.write(path.with_suffix(".other.raw"), events, sensor=SENSOR)
    with path.open("r+b") as file:
        file.write(path.with_suffix(".other.raw").read_bytes())
        file.truncate()


@pytest.mark.parametrize("change", [replace, overwrite])
def test_two_contents_of_a_file_are_not_mixed(tmp_path: Path, events: Any, change: Any) -> None:
    path = tmp_path / "a.raw"
    eecvs.write(path, events, sensor=SENSOR)
    recording, read_before = eecvs.open(path), eecvs.open(path)
    assert recording.info.events == len(events) == len(read_before.read())
    data = Windows(path, 1000)
    assert len(data[0])
    change(path, events[:10])
    for use in (
        read_before.read,
        read_before.columns,
        lambda: read_before.time[0:5],
        lambda: list(read_before),
        lambda: data[0],
        lambda: read_before.info,
    ):
        with pytest.raises(eecvs.RefusedError, match="changed or replaced since it was opened: open it again"):
            use()
    if change is replace:
        # What was opened first is still open.
        assert len(recording.read()) == len(events)
    with pytest.raises(eecvs.RefusedError, match="changed or replaced"):
        recording.read()
    assert len(eecvs.open(path).read()) == 10


def test_a_folder_of_other_files_is_another_one(tmp_path: Path, events: Any) -> None:
    folder = tmp_path / "events"
    folder.mkdir()
    for name in "txyp":
        np.save(folder / f"{name}.npy", events[name])
    recording = eecvs.open(folder, width=64, height=48)
    assert len(recording.read()) == len(recording.read()) == len(events)
    np.save(folder / "p.npy", ~events["p"])
    with pytest.raises(eecvs.RefusedError, match="changed or replaced"):
        recording.read()


def test_a_file_may_grow_until_it_is_read(tmp_path: Path, events: Any) -> None:
    eecvs.write(tmp_path / "whole.dat", events, sensor=SENSOR)
    whole, path = (tmp_path / "whole.dat").read_bytes(), tmp_path / "a.dat"
    path.write_bytes(whole[: len(whole) - 8 * 1000])
    recording = eecvs.open(path)
    with path.open("ab") as file:
        file.write(whole[len(whole) - 8 * 1000 :])
    assert len(recording.read()) >= len(events) - 1000
    with pytest.raises(eecvs.RefusedError, match="changed or replaced"):
        recording.read()


def test_a_removed_file_is_missing(tmp_path: Path, events: Any) -> None:
    path = tmp_path / "a.raw"
    eecvs.write(path, events, sensor=SENSOR)
    recording = eecvs.open(path)
    path.unlink()
    if os.name == "posix":
        assert same(recording.read(), events)
    with pytest.raises(eecvs.MissingFileError):
        recording.read()


def test_paths_are_those_of_the_folder_at_the_call(tmp_path: Path, events: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    there, elsewhere = tmp_path / "there", tmp_path / "elsewhere"
    there.mkdir()
    elsewhere.mkdir()
    monkeypatch.chdir(there)
    eecvs.write("a.raw", events, sensor=SENSOR)
    recording, data = eecvs.open("a.raw"), Windows("a.raw", 1000)

    def parts() -> Any:
        yield events[:1000]
        os.chdir(elsewhere)
        yield events[1000:]

    assert eecvs.write("b.raw", parts(), sensor=SENSOR).path == "b.raw"
    assert Path.cwd() == elsewhere and list(elsewhere.iterdir()) == []
    assert recording.path == there / "a.raw"
    for _ in range(2):
        assert same(recording.read(), events)
    assert recording.info.events == len(events) and len(data[0])
    assert same(pickle.loads(pickle.dumps(recording)).read(), events)
    assert same(eecvs.open(there / "b.raw").read(), events)
