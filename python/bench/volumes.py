"""Speed of voxel grids and histograms beside others', on one core, in one run; prints a table in Markdown.

    python python/bench/volumes.py [--save docs/python.md] [FOLDER OF RECORDINGS]

Every package makes the arrays of the same windows of 33 ms, whose events are in memory in its own layout.
"""

from __future__ import annotations

import argparse
import os
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

ROUNDS = 9
BINS = 10
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
parser.add_argument("--save", metavar="FILE.md", help="also put the table into this document, between its marks")
ARGUMENTS = parser.parse_args()
FOLDER: Path = ARGUMENTS.folder
FILES = ["davis346_building_dense/davis.aedat4", "gen3_vga_dense_evt2/evt2.raw", "dvxl_person_moderate/data_sample.aedat4"]


def best(make: Callable[[Any], Any], windows: list[Any]) -> float:
    seconds = float("inf")
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for window in windows:
            make(window)
        seconds = min(seconds, time.perf_counter() - start)
    return sum(map(len, windows)) / seconds / 1e6


def main() -> None:
    lines = [
        f"Million events a second, ten bins, windows of 33 ms, one core of {cpu()}:",
        "",
        "| file | eecvs voxel, bilinear | nearest | counts (RVT) | time surface | TORE | tonic voxel | numpy counts |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for file in FILES:
        recording = eecvs.open(FOLDER / file)
        size = recording.sensor
        windows = [window for window in recording.by_time(33_000) if len(window) > 1]
        out = np.empty((BINS, size.height, size.width), np.float32)
        bytes_ = np.empty((2 * BINS, size.height, size.width), np.uint8)
        speeds = [
            best(lambda w: eecvs.voxel(w, BINS, sensor=size, out=out), windows),
            best(lambda w: eecvs.voxel(w, BINS, sensor=size, weights="nearest", out=out), windows),
            best(lambda w: eecvs.counts(w, BINS, sensor=size, out=bytes_), windows),
            best(lambda w: eecvs.time_surface(w, 1e4, sensor=size), windows),
            best(lambda w: eecvs.tore(w, sensor=size), windows),
        ]
        cells = [f"{speed:.0f}" for speed in speeds]
        try:
            # What tonic's data sets need, which nothing here does.
            for name in ["importRosbag", "importRosbag.importRosbag", "librosa", "loris"]:
                module: Any = ModuleType(name)
                module.importRosbag = None
                sys.modules.setdefault(name, module)
            from tonic.functional import to_voxel_grid_numpy

            layout = [("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "<i2")]
            theirs = []
            for window in windows:
                events = np.empty(len(window), layout)
                for name in "xytp":
                    events[name] = window[name]
                theirs.append(events)
            grid = best(lambda w: to_voxel_grid_numpy(w.copy(), (*size, 2), BINS), theirs)
            cells.append(f"{grid:.0f}")
        except ImportError as error:
            print(f"tonic: {error}", file=sys.stderr)
            cells.append("")

        def twin(window: Any) -> Any:
            t = window["t"] - window["t"][0]
            index = np.minimum(t * BINS // max(int(t[-1]), 1), BINS - 1)
            flat = ((window["p"] * BINS + index) * size.height + window["y"]) * size.width + window["x"]
            return np.bincount(flat, minlength=2 * BINS * size.height * size.width)

        cells.append(f"{best(twin, windows):.0f}")
        lines.append(f"| {file.split('/')[0]} | " + " | ".join(cells) + " |")
    put("volumes", lines, ARGUMENTS.save)


if __name__ == "__main__":
    main()
