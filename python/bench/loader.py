"""Windows a second of torch's DataLoader over `.eecvs` and over `.npz` of the same events; prints a table in Markdown.

    python python/bench/loader.py [--save docs/python.md] [FOLDER OF RECORDINGS]

Every data set has the same windows, in a random order and in batches, and makes voxel grids of them by this package. They
differ in where a window's events come from:

- `.eecvs`: one file, by the quick coder, whose windows are those of the data set; one is decoded for each item.
- `.npz`: a file for each window, by `numpy.savez`, read at each item.
- compressed: the same by `numpy.savez_compressed`.
- in memory: one `.npz`, which each process reads whole, before it is timed: for recordings that all processes can hold.

Epochs of all data sets take turns, and the number is that of the quickest. Workers are started before.
"""

from __future__ import annotations

import argparse
import os
import random
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np  # noqa: E402
import torch  # noqa: E402
from torch.utils.data import DataLoader  # noqa: E402

import eecvs  # noqa: E402
from eecvs.data import Windows  # noqa: E402
from table import cpu, put  # noqa: E402

EPOCHS_MIN = 3
SECONDS = 20
WINDOWS_MAX = 100
BINS = 5
WINDOW_US = 10_000
BATCH = 4
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
parser.add_argument("--save", metavar="FILE.md", help="also put the table into this document, between its marks")
FILES = ["davis346_building_dense/davis.aedat4", "gen3_vga_dense_evt2/evt2.raw", "imx636_sparse_evt3/evt3.raw"]

Arrays = dict[str, Any]


class InMemory:
    """The windows of an `.npz`, whose columns a process reads once."""

    def __init__(self, path: Path, like: Windows) -> None:
        self.path, self.like = path, like
        self.arrays: Arrays | None = None

    def __len__(self) -> int:
        return len(self.like)

    def __getitem__(self, index: int) -> Any:
        if self.arrays is None:
            with np.load(self.path) as file:
                self.arrays = {name: file[name] for name in "txyp"}
        start, end = self.like.times(index)
        first, last = np.searchsorted(self.arrays["t"], [start, end])
        events = {name: column[first:last] for name, column in self.arrays.items()}
        return self.like.make(events, sensor=self.like.sensor, t0_us=start, t1_us=end)  # type: ignore[misc]


class FileByFile:
    """The windows of a folder with an `.npz` for each of them."""

    def __init__(self, folder: Path, like: Windows) -> None:
        self.folder, self.like = folder, like

    def __len__(self) -> int:
        return len(self.like)

    def __getitem__(self, index: int) -> Any:
        start, end = self.like.times(index)
        with np.load(self.folder / f"{index}.npz") as file:
            events = {name: file[name] for name in "txyp"}
        return self.like.make(events, sensor=self.like.sensor, t0_us=start, t1_us=end)  # type: ignore[misc]


def columns_of(events: Any) -> Arrays:
    return {name: np.ascontiguousarray(events[name]) for name in "txyp"}


def made(source: Path, folder: Path) -> tuple[dict[str, Any], dict[str, int], int]:
    """Returns data sets by their names, their bytes on disk, and the number of events."""
    recording = eecvs.open(source)
    events = recording.read()
    events = events[np.argsort(events["t"], kind="stable")]
    start_us = int(events["t"][0])
    # All of them would take hours.
    events = events[events["t"] < start_us + WINDOWS_MAX * WINDOW_US]
    path = folder / "a.eecvs"
    eecvs.write(path, events, sensor=recording.sensor, coder="quick", window_us=WINDOW_US, origin_us=start_us)
    like = Windows(path, WINDOW_US, partial(eecvs.voxel, bins=BINS))
    assert like.start_us == start_us
    sets: dict[str, Any] = {".eecvs": like}
    sizes = {".eecvs": path.stat().st_size}
    for name, save in ((".npz", np.savez), ("compressed", np.savez_compressed)):
        parts = folder / name.strip(".")
        parts.mkdir()
        for index in range(len(like)):
            save(parts / f"{index}.npz", **columns_of(like.events(index)))
        sets[name] = FileByFile(parts, like)
        sizes[name] = sum(file.stat().st_size for file in parts.iterdir())
    np.savez(folder / "a.npz", **columns_of(events))
    sets["in memory"] = InMemory(folder / "a.npz", like)
    for index in (0, len(like) // 2, len(like) - 1):
        for name, other in sets.items():
            assert np.allclose(other[index], like[index], atol=1e-3), f"window {index} of {name} differs"
    return sets, sizes, len(events)


def speeds(sets: dict[str, Any], workers: int) -> dict[str, float]:
    """Returns the windows a second of each data set."""
    loaders = {
        name: DataLoader(data, batch_size=BATCH, shuffle=True, num_workers=workers, persistent_workers=workers > 0)
        for name, data in sets.items()
    }
    best = dict.fromkeys(sets, float("inf"))
    epoch, end = 0, float("inf")
    while epoch <= EPOCHS_MIN or time.perf_counter() < end:
        for name, loader in random.sample(list(loaders.items()), len(loaders)):
            start = time.perf_counter()
            seen = sum(len(batch) for batch in loader)
            # In the first one, workers start and files are read into memory.
            if epoch > 0:
                best[name] = min(best[name], time.perf_counter() - start)
            assert seen == len(sets[name])
        if epoch == 0:
            end = time.perf_counter() + SECONDS
        epoch += 1
    return {name: len(sets[name]) / seconds for name, seconds in best.items()}


def main() -> None:
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    lines = [
        f"Windows a second, of {WINDOW_US // 1000} ms, as grids of {BINS} bins in batches of {BATCH}; bytes an event on disk; torch",
        f"{torch.__version__}, {os.cpu_count()} cores of {cpu()}:",
        "",
        "| file | events a window | workers | `.eecvs` | `.npz` | compressed | in memory | bytes: `.eecvs` | `.npz` | compressed |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for file in FILES:
        with tempfile.TemporaryDirectory() as folder:
            sets, sizes, events = made(arguments.folder / file, Path(folder))
            for workers in (0, 2):
                found = speeds(sets, workers)
                cells = [f"{speed:.0f}" for speed in found.values()]
                cells += [f"{size / events:.1f}" for size in sizes.values()]
                row = [file.split("/")[0], str(events // len(sets[".eecvs"])), str(workers), *cells]
                lines.append("| " + " | ".join(row) + " |")
    put("loader", lines, arguments.save)


if __name__ == "__main__":
    main()
