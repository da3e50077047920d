"""Reading speed of this package beside others', on one core, in one run; prints a table in Markdown.

    python python/bench/read_speed.py [--save docs/python.md] [FOLDER OF RECORDINGS]

Every package reads each file to an array in memory, in its own quickest way. Packages take turns, in an order that changes
from round to round, so that neither a change of the machine's speed nor what another package leaves in the caches meets
one of them alone; the number is that of the quickest of the rounds.
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
from typing import Any

ROUNDS = 50

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ.setdefault("POLARS_MAX_THREADS", "1")
os.environ.setdefault("RAYON_NUM_THREADS", "1")

import eecvs  # noqa: E402
from table import cpu, put  # noqa: E402

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
parser.add_argument("--save", metavar="FILE.md", help="also put the table into this document, between its marks")
ARGUMENTS = parser.parse_args()
FOLDER: Path = ARGUMENTS.folder
FILES = {
    "gen3_vga_dense_evt2/evt2.raw": "evt2",
    "imx636_sparse_evt3/evt3.raw": "evt3",
    "imx636_sparse_dat/gen4.dat": "dat",
    "davis346_static_sparse/davis346.aedat4": "aedat4",
    "dvxl_person_moderate/data_sample.aedat4": "aedat4",
}

Read = Callable[[str], Any]


def of_faery(encoding: str) -> Read:
    import faery

    return lambda path: faery.events_stream_from_file(path).to_array()


def of_expelliarmus(encoding: str) -> Read:
    import expelliarmus

    if encoding == "aedat4":
        raise KeyError(encoding)
    wizard = expelliarmus.Wizard(encoding=encoding)
    return lambda path: wizard.read(path)


def of_evlib(encoding: str) -> Read:
    import evlib

    return lambda path: evlib.load_events(path).collect()


def of_aedat(encoding: str) -> Read:
    import aedat
    import numpy as np

    if encoding != "aedat4":
        raise KeyError(encoding)
    return lambda path: np.concatenate([p["events"] for p in aedat.Decoder(path) if "events" in p])


def of_dv_processing(encoding: str) -> Read:
    import dv_processing as dv

    if encoding != "aedat4":
        raise KeyError(encoding)

    def read(path: str) -> Any:
        recording, store = dv.io.MonoCameraRecording(path), dv.EventStore()
        while recording.isRunning():
            batch = recording.getNextEventBatch()
            if batch is not None:
                store.add(batch)
        return store.numpy()

    return read


PACKAGES: dict[str, Callable[[str], Read]] = {
    "eecvs": lambda _: lambda path: eecvs.open(path).read(),
    "eecvs, columns": lambda _: lambda path: eecvs.open(path).columns(),
    "faery": of_faery,
    "expelliarmus": of_expelliarmus,
    "evlib": of_evlib,
    "aedat": of_aedat,
    "dv-processing": of_dv_processing,
}


def title(name: str) -> str:
    try:
        return name if name.startswith("eecvs") else f"{name} {importlib.metadata.version(name)}"
    except importlib.metadata.PackageNotFoundError:
        return name


def main() -> None:
    names, rows = [], []
    for file, encoding in FILES.items():
        path = str(FOLDER / file)
        events = len(eecvs.open(path).read())
        reads: dict[str, Read] = {}
        for name, make in PACKAGES.items():
            try:
                reads[name] = make(encoding)
                found = len(reads[name](path))
            except Exception as error:  # Whatever another package does not read is an empty cell.
                reads.pop(name, None)
                print(f"{file}: {name}: {type(error).__name__}: {error}"[:160], file=sys.stderr)
                continue
            if found != events:
                print(f"{file}: {name} gives {found} of {events} events", file=sys.stderr)
        best = dict.fromkeys(reads, float("inf"))
        for _ in range(ROUNDS):
            order = random.sample(list(reads.items()), len(reads))
            for name, read in order:
                start = time.perf_counter()
                read(path)
                best[name] = min(best[name], time.perf_counter() - start)
        rows.append((file, events, {name: events / seconds / 1e6 for name, seconds in best.items()}))
        names = list(PACKAGES)
    lines = [
        f"Million events a second, one core of {cpu()}:",
        "",
        "| file | events | " + " | ".join(title(name) for name in names) + " |",
        "|---|---|" + "---|" * len(names),
    ]
    for file, events, speeds in rows:
        cells = [f"{speeds[name]:.0f}" if name in speeds else "" for name in names]
        lines.append(f"| {file.split('/')[0]} | {events / 1e6:.1f} M | " + " | ".join(cells) + " |")
    put("read_speed", lines, ARGUMENTS.save)


if __name__ == "__main__":
    main()
