"""Speed of voxel grids and histograms beside others', on one core, in one run; prints a table in Markdown.

    python python/bench/volumes.py [--save docs/python.md] [FOLDER OF RECORDINGS]

Every package makes the arrays of the same windows of 33 ms, whose events are in memory in its own layout: arrays of NumPy,
or a table of Polars for evlib, which makes rows of the voxels that are not 0, and then an array of these. Packages take turns,
and the number is that of the quickest round.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import random
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ.setdefault("POLARS_MAX_THREADS", "1")
os.environ.setdefault("RAYON_NUM_THREADS", "1")

import numpy as np  # noqa: E402

import eecvs  # noqa: E402
from table import cpu, put  # noqa: E402

ROUNDS = 40
BINS = 10
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
parser.add_argument("--save", metavar="FILE.md", help="also put the table into this document, between its marks")
ARGUMENTS = parser.parse_args()
FOLDER: Path = ARGUMENTS.folder
FILES = ["davis346_building_dense/davis.aedat4", "gen3_vga_dense_evt2/evt2.raw", "dvxl_person_moderate/data_sample.aedat4"]


#: A function that makes an array of a window, and the windows in that package's layout.
Maker = tuple[Callable[[Any], Any], list[Any]]


def speeds(makers: dict[str, Maker]) -> dict[str, float]:
    """Returns the million events a second of each, in its quickest round; they take turns, in an order that changes."""
    best = dict.fromkeys(makers, float("inf"))
    for _ in range(ROUNDS):
        for name, (make, windows) in random.sample(list(makers.items()), len(makers)):
            start = time.perf_counter()
            for window in windows:
                make(window)
            best[name] = min(best[name], time.perf_counter() - start)
    return {name: sum(map(len, makers[name][1])) / seconds / 1e6 for name, seconds in best.items()}


def of_tonic(size: eecvs.Sensor) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Returns what makes tonic's events of a window, and what makes its grid of these."""
    # What tonic's data sets need, which nothing here does.
    for name in ["importRosbag", "importRosbag.importRosbag", "librosa", "loris"]:
        module: Any = ModuleType(name)
        module.importRosbag = None
        sys.modules.setdefault(name, module)
    from tonic.functional import to_voxel_grid_numpy

    layout = [("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "<i2")]

    def take(window: Any) -> Any:
        events = np.empty(len(window), layout)
        for name in "xytp":
            events[name] = window[name]
        return events

    # It writes into what it is given.
    return take, lambda events: to_voxel_grid_numpy(events.copy(), (*size, 2), BINS)[:, 0]


def of_evlib(size: eecvs.Sensor) -> tuple[Callable[[Any], Any], Callable[[Any], Any], Callable[[Any], Any]]:
    """Returns what makes evlib's table of a window, what makes its rows of voxels, and what makes a grid of the table."""
    import polars
    from evlib.representations import create_voxel_grid, densify_voxel_grid

    def take(window: Any) -> Any:
        # As its reader gives them.
        t = polars.Series(np.ascontiguousarray(window["t"])).cast(polars.Duration("us"))
        p = np.where(window["p"], 1, -1).astype(np.int8)
        return polars.DataFrame({"t": t, "x": window["x"].astype("i2"), "y": window["y"].astype("i2"), "polarity": p})

    def rows(table: Any) -> Any:
        return create_voxel_grid(table, size.height, size.width, BINS)

    return take, rows, lambda table: densify_voxel_grid(rows(table), BINS, size.height, size.width)[:, 0]


def check(name: str, grid: Any, window: Any, size: eecvs.Sensor) -> None:
    """Raises an error if another package's grid is not the one that this package makes: then their times say nothing."""
    # Both scale times by the number of bins, and let the last one go.
    wanted = eecvs.voxel(window, BINS + 1, sensor=size)[:BINS]
    if not np.allclose(grid, wanted, atol=1e-3):
        raise SystemExit(f"{name} makes another grid: the largest difference is {np.abs(grid - wanted).max()}")


def title(name: str, of: str) -> str:
    try:
        return f"{name} {importlib.metadata.version(name)} {of}"
    except importlib.metadata.PackageNotFoundError:
        return f"{name} {of}"


def main() -> None:
    names = ["eecvs voxel, bilinear", "nearest", "counts (RVT)", "time surface", "TORE"]
    names += [title("tonic", "voxel"), title("evlib", "voxel"), "its rows alone", "numpy counts"]
    lines = [
        f"Million events a second, ten bins, windows of 33 ms, one core of {cpu()}:",
        "",
        "| file | " + " | ".join(names) + " |",
        "|---" * (len(names) + 1) + "|",
    ]
    for file in FILES:
        recording = eecvs.open(FOLDER / file)
        size = recording.sensor
        windows = [window for window in recording.by_time(33_000) if len(window) > 1]
        out = np.empty((BINS, size.height, size.width), np.float32)
        bytes_ = np.empty((2 * BINS, size.height, size.width), np.uint8)
        makers: dict[str, Maker] = {
            "eecvs voxel, bilinear": (lambda w: eecvs.voxel(w, BINS, sensor=size, out=out), windows),
            "nearest": (lambda w: eecvs.voxel(w, BINS, sensor=size, weights="nearest", out=out), windows),
            "counts (RVT)": (lambda w: eecvs.counts(w, BINS, sensor=size, out=bytes_), windows),
            "time surface": (lambda w: eecvs.time_surface(w, 1e4, sensor=size), windows),
            "TORE": (lambda w: eecvs.tore(w, sensor=size), windows),
        }
        try:
            take, grid = of_tonic(size)
            theirs = [take(window) for window in windows]
            check("tonic", grid(theirs[0]), windows[0], size)
            makers[title("tonic", "voxel")] = grid, theirs
        except ImportError as error:
            print(f"tonic: {error}", file=sys.stderr)
        try:
            take, rows, grid = of_evlib(size)
            theirs = [take(window) for window in windows]
            check("evlib", grid(theirs[0]), windows[0], size)
            makers[title("evlib", "voxel")] = grid, theirs
            makers["its rows alone"] = rows, theirs
        except ImportError as error:
            print(f"evlib: {error}", file=sys.stderr)

        def twin(window: Any) -> Any:
            t = window["t"] - window["t"][0]
            index = np.minimum(t * BINS // max(int(t[-1]), 1), BINS - 1)
            flat = ((window["p"] * BINS + index) * size.height + window["y"]) * size.width + window["x"]
            return np.bincount(flat, minlength=2 * BINS * size.height * size.width)

        makers["numpy counts"] = twin, windows
        found = speeds(makers)
        cells = [f"{found[name]:.{0 if found[name] >= 10 else 1}f}" if name in found else "" for name in names]
        lines.append(f"| {file.split('/')[0]} | " + " | ".join(cells) + " |")
    put("volumes", lines, ARGUMENTS.save)


if __name__ == "__main__":
    main()
