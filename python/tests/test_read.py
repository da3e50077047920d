"""Reading: every format, layouts, slices, losses, threads and processes."""

from __future__ import annotations

import gc
import hashlib
import multiprocessing
import os
import pickle
import resource
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SENSOR, SHARED, random_events, same

import eecvs

ENDINGS = [
    ".raw", ".evt2.raw", ".evt21.raw", ".evt4.raw", ".dat", ".aedat4", ".es", ".h5", ".mat", ".npz", ".npy", ".arrow",
    ".arrows", ".feather", ".parquet", ".bag", ".mcap", ".db3", ".csv", ".txt", ".eecvs",
]  # fmt: skip


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_format_gives_what_was_written(tmp_path: Path, events: Any, ending: str) -> None:
    path = tmp_path / ("a" + ending)
    written = eecvs.write(path, events, sensor=SENSOR)
    assert (written.path, written.events_in, written.events_out) == (str(path), 20_000, 20_000)
    options: dict[str, Any] = {"width": 64, "height": 48} if ending in (".txt", ".csv") else {}
    recording = eecvs.open(path, **options)
    assert recording.sensor == eecvs.Sensor(*SENSOR)
    found = recording.read()
    if ending == ".eecvs":
        # Events of equal time come in the order of pixels.
        found, events = np.sort(found), np.sort(events)
    assert same(found, events)
    assert recording.losses == {}


@pytest.mark.parametrize("name", list(eecvs.DTYPES))
def test_layouts_have_the_same_events(recording: eecvs.Recording, events: Any, name: Any) -> None:
    found = eecvs.open(recording.path, dtype=name).read()
    assert found.dtype == eecvs.DTYPES[name]
    assert same(found, events)
    # What is no field is 0, so that equal events have equal bytes.
    again = np.zeros(len(found), found.dtype)
    for field in found.dtype.names:
        again[field] = found[field]
    assert again.tobytes() == found.tobytes()
    # And they come back in.
    assert eecvs.encode(found, sensor=SENSOR) == eecvs.encode(events, sensor=SENSOR)


def test_an_unknown_layout_is_refused(recording: eecvs.Recording) -> None:
    with pytest.raises(ValueError, match="metavision"):
        eecvs.open(recording.path, dtype="what")  # type: ignore[arg-type]


def test_columns_are_contiguous(recording: eecvs.Recording, events: Any) -> None:
    columns = recording.columns()
    for name in "txyp":
        column = getattr(columns, name)
        assert column.flags.c_contiguous
        assert np.array_equal(column, events[name])
    assert [getattr(columns, name).dtype for name in "txyp"] == [np.int64, np.uint16, np.uint16, np.bool_]
    assert columns.sensor == SENSOR
    assert len(columns) == len(events)


def test_info(recording: eecvs.Recording, events: Any) -> None:
    info = recording.info
    assert (info.format, info.width, info.height, info.events) == ("evt3", *SENSOR, len(events))
    assert info.on == np.count_nonzero(events["p"])
    assert info.off == len(events) - info.on
    assert (info.t_first_us, info.t_last_us) == (events["t"].min(), events["t"].max())
    hashed = hashlib.sha256()
    for name, kind in [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")]:
        hashed.update(events[name].astype(kind).tobytes())
    assert info.sha256_events == hashed.hexdigest()
    assert recording.info is info


@pytest.mark.parametrize("ending", [".raw", ".dat", ".aedat4", ".parquet", ".eecvs", ".h5"])
def test_ranges_of_time(tmp_path: Path, events: Any, ending: str) -> None:
    path = tmp_path / ("a" + ending)
    eecvs.write(path, events, sensor=SENSOR)
    recording = eecvs.open(path)
    t = events["t"]
    for start, stop in [
        (None, None), (0, 1), (int(t[500]), int(t[900])), (int(t[500]), int(t[500]) + 1), (int(t[-1]), None),
        (int(t[-1]) + 1, None), (None, int(t[7])), (int(t[900]), int(t[500])), (np.int64(t[3]), np.int64(t[5])),
    ]:  # fmt: skip
        low, high = start or 0, np.iinfo(np.int64).max if stop is None else stop
        wanted = events[(t >= low) & (t < high)]
        found = recording.time[start:stop]
        assert same(np.sort(found), np.sort(wanted)), (start, stop)


def test_wrong_ranges_of_time(recording: eecvs.Recording) -> None:
    for wrong in [slice(0, 9, 2), slice(-1, None), slice(0.5, None)]:
        with pytest.raises((TypeError, ValueError)):
            recording.time[wrong]
    with pytest.raises(TypeError):
        recording.time[3]  # type: ignore[index]


@pytest.mark.parametrize(("us", "origin"), [(1, None), (997, None), (10_000, 0), (10_000, 123), (10**12, None)])
def test_slices_of_time(recording: eecvs.Recording, events: Any, us: int, origin: int | None) -> None:
    if us == 1:
        events = events[:200]
    t = events["t"]
    start = int(t[0]) if origin is None else origin + (int(t[0]) - origin) // us * us
    slices = recording.by_time(us, origin_us=origin)
    assert slices.times is None
    seen = 0
    for found in slices:
        assert slices.times == (start, start + us)
        wanted = t[(t >= start) & (t < start + us)]
        assert np.array_equal(found["t"], wanted) or us == 1
        seen += len(found)
        start += us
        if us == 1 and seen >= 200:
            return
    assert seen == len(events)
    assert start > t[-1]


@pytest.mark.parametrize("n", [1, 1000, 16_384, 16_385, 10**9])
def test_slices_of_number(recording: eecvs.Recording, events: Any, n: int) -> None:
    slices = list(recording.by_count(n))
    assert [len(found) for found in slices] == [len(events[i : i + n]) for i in range(0, len(events), n)]
    assert same(np.concatenate(slices), events)


def test_slices_of_nothing_are_refused(recording: eecvs.Recording) -> None:
    for wrong in (0, -1):
        with pytest.raises(ValueError, match=f"^us is {wrong}: it must be 1 to"):
            recording.by_time(wrong)
        with pytest.raises(ValueError, match=f"^n is {wrong}: it must be 1 to"):
            recording.by_count(wrong)


def test_batches_begin_again(recording: eecvs.Recording, events: Any) -> None:
    for _ in range(2):
        assert same(np.concatenate(list(recording)), events)
    one, other = iter(recording), iter(recording)
    assert same(next(one), next(other))
    assert iter(one) is one


def test_times_that_run_backwards(tmp_path: Path, events: Any) -> None:
    path = tmp_path / "a.raw"
    back = np.concatenate([events[10_000:], events[:10_000]])
    eecvs.write(path, back, sensor=SENSOR)
    with pytest.raises(eecvs.RefusedError, match="sort="):
        list(eecvs.open(path).by_time(1000))
    found = np.concatenate(list(eecvs.open(path, sort=True).by_time(1000)))
    assert same(found, events)
    assert eecvs.open(path).info.times_back == 1


def test_a_closed_recording_is_not_read(recording: eecvs.Recording) -> None:
    with recording as same_one:
        assert same_one is recording
        assert len(recording.read())
    with pytest.raises(ValueError, match="closed"):
        recording.read()


def test_errors_name_file_and_offset(tmp_path: Path, events: Any) -> None:
    with pytest.raises(FileNotFoundError) as missing:
        eecvs.open(tmp_path / "none.raw")
    assert isinstance(missing.value, eecvs.MissingFileError)
    assert missing.value.file == str(tmp_path / "none.raw")
    assert missing.value.errno == 2
    noise = tmp_path / "noise.raw"
    noise.write_bytes(bytes(range(256)) * 20)
    with pytest.raises(eecvs.EecvsError) as unknown:
        eecvs.open(noise)
    assert unknown.value.file == str(noise)
    with pytest.raises(OSError) as folder:
        eecvs.open(tmp_path)
    assert isinstance(folder.value, eecvs.EecvsError)
    table = tmp_path / "a.dat"
    header = b"% Data file containing CD events.\n% Version 2\n"
    table.write_bytes(header + bytes([12, 8]) + bytes(16))
    with pytest.raises(eecvs.UndecidedError, match="width=W height=H") as undecided:
        eecvs.open(table).read()
    assert undecided.value.offset == len(header) + 2
    assert len(eecvs.open(table, width=5, height=5).read()) == 2
    with pytest.raises(ValueError, match="time_unit"):
        eecvs.open(table, time_unit="years")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="together"):
        eecvs.open(table, width=5)
    with pytest.raises(ValueError, match="2048"):
        eecvs.open(table, width=5000, height=1)


def test_events_before_damage(tmp_path: Path, recording: eecvs.Recording, events: Any) -> None:
    cut = tmp_path / "cut.raw"
    cut.write_bytes(Path(recording.path).read_bytes()[:-1])
    for read in [lambda r: r.read(), lambda r: r.columns(), lambda r: r.time[0:]]:
        with pytest.raises(eecvs.DamagedError) as damaged:
            read(eecvs.open(cut))
        assert damaged.value.file == str(cut)
        assert damaged.value.offset is not None
        assert abs(damaged.value.offset - cut.stat().st_size) <= 2
        before = len(damaged.value.events)  # type: ignore[attr-defined]
        assert len(events) - 12 <= before < len(events)
    found = []
    with pytest.raises(eecvs.DamagedError):
        for batch in eecvs.open(cut):
            found.append(batch)
    assert same(np.concatenate(found), events[:before])
    kept = eecvs.open(cut, damaged="keep")
    with pytest.warns(eecvs.LossWarning, match="cut.raw: byte"):
        assert len(kept.read()) == before
    assert kept.damage is not None and "byte" in kept.damage
    with pytest.warns(eecvs.LossWarning):
        assert sum(map(len, kept.by_time(1000))) == before


def test_bad_events_are_refused_or_counted(tmp_path: Path) -> None:
    table = tmp_path / "a.csv"
    table.write_text("t,x,y,p\n1,2,3,1\n2,99,3,1\n3,2,3,0\n")
    options: Any = {"width": 8, "height": 8, "time_unit": "us"}
    with pytest.raises(eecvs.DamagedError) as bad:
        eecvs.open(table, **options).read()
    assert len(bad.value.events) == 1  # type: ignore[attr-defined]
    recording = eecvs.open(table, leave_out_bad_events=True, **options)
    with pytest.warns(eecvs.LossWarning, match="1 events outside of the sensor"):
        assert recording.read()["t"].tolist() == [1, 3]
    assert recording.losses == {"events outside of the sensor": 1}


def test_any_bytes_raise_and_never_abort(tmp_path: Path, events: Any) -> None:
    """Damage anywhere in files of every format, in a process of its own, which has to end well."""
    for ending in ENDINGS:
        eecvs.write(tmp_path / ("a" + ending), events[:500], sensor=SENSOR)
    program = """
import random, sys, warnings
import eecvs
warnings.simplefilter("ignore")
random.seed(7)
for path in sys.argv[1:]:
    whole = open(path, "rb").read()
    for _ in range(25):
        data = bytearray(whole)
        for _ in range(random.randrange(1, 6)):
            data[random.randrange(len(data))] = random.randrange(256)
        data = data[: random.randrange(len(data) + 1)] if random.random() < 0.5 else data
        name = path.replace("/a", "/b", 1) if "/a." in path else path
        name = path[: path.rindex("/")] + "/b" + path[path.rindex("/a") + 2 :]
        open(name, "wb").write(data)
        try:
            recording = eecvs.open(name, width=64, height=48)
            recording.read()
            recording.time[1_000_100:1_000_900]
        except (eecvs.EecvsError, ValueError) as error:
            assert str(error)
print("ended well")
"""
    paths = [str(tmp_path / ("a" + ending)) for ending in ENDINGS]
    ended = subprocess.run([sys.executable, "-c", program, *paths], capture_output=True, text=True, timeout=500)
    assert ended.stdout == "ended well\n", ended.stderr[-2000:]
    assert ended.returncode == 0


def test_a_panic_is_an_exception() -> None:
    with pytest.raises(BaseException, match="as asked for") as panic:
        eecvs._eecvs._panic()
    assert type(panic.value).__name__ == "PanicException"


def test_pickled_recordings_are_opened_again(recording: eecvs.Recording, events: Any) -> None:
    tonic = eecvs.open(recording.path, dtype="tonic")
    assert same(pickle.loads(pickle.dumps(tonic)).read(), events)
    assert pickle.loads(pickle.dumps(tonic)).read().dtype == eecvs.DTYPES["tonic"]


def test_threads_share_a_recording(recording: eecvs.Recording, events: Any) -> None:
    found: list[Any] = []
    threads = [threading.Thread(target=lambda: found.append(recording.read())) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4 and all(same(one, events) for one in found)


def test_other_threads_run_meanwhile(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    eecvs.write(path, random_events(600_000), sensor=SENSOR)
    ticks = []
    done = threading.Event()

    def tick() -> None:
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    start = time.perf_counter()
    eecvs.open(path, width=64, height=48).read()
    end = time.perf_counter()
    done.set()
    thread.join()
    inside = [t for t in ticks if start < t < end]
    assert len(inside) >= 3, (end - start, len(inside))


def _in_child(path: str, recording: Any, begun: Any, queue: Any) -> None:
    try:
        next(begun)
        queue.put("read on")
    except eecvs.RefusedError:
        queue.put((len(recording.read()), len(eecvs.open(path).read()), eecvs.voxel(
            [recording.read()] * 3, 2, sensor=SENSOR).shape))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forked processes here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_forked_processes_read_for_themselves(tmp_path: Path, events: Any) -> None:
    path = tmp_path / "a.eecvs"
    eecvs.write(path, events[:2000], sensor=SENSOR, mode="transform")
    recording = eecvs.open(path)
    count = len(recording.read())
    # Threads of the parent's pool are not there in the child.
    eecvs.voxel([recording.read()] * 3, 2, sensor=SENSOR)
    begun = iter(recording)
    next(begun)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    for _ in range(3):
        child = context.Process(target=_in_child, args=(str(path), recording, begun, queue))
        child.start()
        assert queue.get(timeout=60) == (count, count, (3, 2, 48, 64))
        child.join()
    assert len(recording.read()) == count


def test_nothing_leaks(tmp_path: Path, events: Any) -> None:
    """10^5 opens, of which one in ten reads: neither files nor memory stay."""
    path = tmp_path / "a.raw"
    eecvs.write(path, events[:300], sensor=SENSOR)

    def opens(count: int) -> None:
        for i in range(count):
            recording = eecvs.open(path)
            if i % 10 == 0:
                recording.read()
                next(iter(recording))

    opens(2_000)
    gc.collect()
    files = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    opens(100_000)
    gc.collect()
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert after - before < 20_000, f"{after - before} KiB more"
    if files:
        assert len(os.listdir("/proc/self/fd")) <= files + 1


def test_the_import_is_quick() -> None:
    program = "import numpy, time; t = time.perf_counter(); import eecvs; print(time.perf_counter() - t)"
    times = [float(subprocess.check_output([sys.executable, "-c", program])) for _ in range(3)]
    assert min(times) < 0.1


def test_a_pipe_is_read_once(tmp_path: Path, recording: eecvs.Recording, events: Any) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    data = Path(recording.path).read_bytes()
    thread = threading.Thread(target=lambda: pipe.write_bytes(data))
    thread.start()
    assert same(eecvs.open(pipe).read(), events)
    thread.join()


FILES = {
    "davis346_static_sparse": {}, "davis346_building_dense": {}, "gen3_vga_dense_evt2": {}, "imx636_sparse_evt3": {},
    "dvxl_person_moderate": {}, "gen31_vga_rosbag_moderate": {}, "davis240_boxes_moderate": {},
    "dvs128_walking_moderate": {}, "dvs128_walking_sparse": {}, "dvs128_standup": {},
    "nmnist": {"width": 34, "height": 34}, "ncars": {"width": 78, "height": 42},
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_shared_recordings(reference: Any, name: str) -> None:
    entry = next(entry for entry in reference if entry["name"] == name)
    for file in entry["files"]:
        options: Any = FILES[name]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", eecvs.LossWarning)
            recording = eecvs.open(SHARED / name / file, **options)
            events = recording.read()
        hashed = hashlib.sha256()
        for field, kind in [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")]:
            hashed.update(events[field].astype(kind).tobytes())
        assert len(events) == entry["events"]
        assert hashed.hexdigest() == entry["sha256_events"]
        assert recording.sensor == (entry["width"], entry["height"])


def test_memory_is_used_again_only_when_nothing_has_it(tmp_path: Path) -> None:
    events = random_events(200_000)
    eecvs.write(tmp_path / "a.raw", events, sensor=SENSOR)
    eecvs.write(tmp_path / "b.raw", events[::-1][:150_000], sensor=SENSOR, sort=True)
    a, b = eecvs.open(tmp_path / "a.raw"), eecvs.open(tmp_path / "b.raw")
    first = a.read()
    part = first[1000:2000]
    del first
    second = b.read()
    assert same(part, events[1000:2000])
    place = part.ctypes.data - 1000 * part.itemsize
    del part
    gc.collect()
    third = a.read()
    assert third.ctypes.data == place
    assert same(third, events) and len(second) == 150_000
    # It is an array like any other.
    assert third.flags.writeable and third.flags.aligned
    third["p"] = True
    assert same(a.read(), events)
