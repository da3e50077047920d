"""Trains a small network to mark what moves by itself, from each input at each M, and measures it on scene types that it has
not seen, on what comes back of encoded events, and on real recordings.

    python python/examples/train/study.py -o FOLDER [--quick] [--recordings FOLDER] [--save README.md]

Writes `record.json` and `iou.svg` into the folder, and prints the tables. An interrupted run goes on where it was. README.md
beside this file has the protocol.
"""

from __future__ import annotations

import os

# One core for each process.
for _library in ("OMP_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(_library, "1")

import argparse  # noqa: E402
import datetime  # noqa: E402
import json  # noqa: E402
import multiprocessing  # noqa: E402
import pickle  # noqa: E402
import platform  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
import time  # noqa: E402
from collections.abc import Sequence  # noqa: E402
from concurrent.futures import ProcessPoolExecutor, as_completed  # noqa: E402
from dataclasses import asdict, dataclass, replace  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any, Union  # noqa: E402

import numpy as np  # noqa: E402
import torch  # noqa: E402

import chart  # noqa: E402
import clips  # noqa: E402
import inputs  # noqa: E402
import network  # noqa: E402
import report  # noqa: E402
from clips import Clip  # noqa: E402

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="for the record and the chart")
parser.add_argument("--quick", action="store_true", help="a small run, to see that everything works: its figures say nothing")
parser.add_argument(
    "--recordings",
    type=Path,
    default=Path(__file__).resolve().parents[4] / "shared" / "data",
    metavar="FOLDER",
    help="real recordings; those that are not there are left out, with a notice",
)
parser.add_argument(
    "--coded-m", type=int, nargs="+", choices=(8, 16, 24), metavar="M", help="the M at which encoded events are measured (16)"
)
parser.add_argument("--processes", type=int, default=2, help="processes of one core each (2)")
parser.add_argument("--so-far", action="store_true", help="train nothing: the record is of what an unfinished run has done")
parser.add_argument("--overwrite", action="store_true", help="replace a record that is there")
parser.add_argument("--save", type=Path, metavar="FILE.md", help="also put the tables into this document, between its marks")


@dataclass(frozen=True)
class Protocol:
    """Everything that a figure depends on."""

    train: tuple[str, ...] = clips.TRAIN
    test: tuple[str, ...] = clips.TEST
    recordings: tuple[str, ...] = clips.RECORDINGS
    sensor: tuple[int, int] = (240, 180)
    window_us: int = clips.WINDOW_US
    #: Windows of a scene, and of a recording at the most.
    windows: int = 30
    windows_recording: int = clips.WINDOWS_MAX
    #: Seeds of the emulator: textures and noise to learn from, and others, of the same scene types, to measure on.
    seeds_train: tuple[int, ...] = (1, 2)
    seed_test: int = 3
    #: Seeds of the network.
    seeds: tuple[int, ...] = (1, 2, 3)
    steps: int = 400
    batch: int = network.BATCH
    learning_rate: float = network.LEARNING_RATE
    #: The one of the tables first.
    m: tuple[int, ...] = (16, 24, 8)
    #: Those of which encoded events are measured.
    m_coded: tuple[int, ...] = (16,)
    steps_log2: tuple[str, ...] = ("2^-6", "2^-2", "2^1", "2^3")
    events: tuple[str, ...] = ("lossless", "128 us", "1024 us", "8192 us")
    #: Bins are exact by a coder of their own; coarser events take fewer bits.
    events_bins: tuple[str, ...] = ("bins", "1024 us", "8192 us")

    def settings(self, name: str) -> list[str]:
        """Returns the ways in which an input's events are encoded."""
        if name in inputs.TRANSFORMS:
            return list(self.steps_log2)
        return list(self.events_bins if name == "bins" else self.events)

    def jobs(self) -> list[tuple[str, int]]:
        """Returns inputs to learn from with their M, those of one M that take longest first."""
        names = ("auto", "dtft", "dwt", "dct", "ces", "tore", "voxel", "bins")
        return [("counts", 2), *((name, m) for m in self.m for name in names)]


QUICK = Protocol(
    train=("indoor-flying", "outdoor-low-brightness"),
    test=("motorcycle", "indoor-dark-blur"),
    recordings=clips.RECORDINGS[4:5],
    sensor=(120, 90),
    windows=6,
    windows_recording=3,
    seeds_train=(1,),
    seeds=(1, 2),
    steps=12,
    m=(8,),
    m_coded=(8,),
    steps_log2=("2^-3", "2^1"),
    events=("lossless", "512 us"),
    events_bins=("bins", "2048 us"),
)


@dataclass(frozen=True)
class Clips:
    """To learn from; and to measure on: other textures of the same scene types, unseen types, recordings."""

    train: list[Clip]
    seen: list[Clip]
    unseen: list[Clip]
    recordings: list[Clip]

    @classmethod
    def of(cls, protocol: Protocol, folder: Path) -> Clips:
        """Emulates the scenes and reads the recordings."""

        def scenes(names: Sequence[str], seeds: Sequence[int]) -> list[Clip]:
            return [clips.of_scene(name, seed, protocol.sensor, protocol.windows) for name in names for seed in seeds]

        recordings = []
        for name in protocol.recordings:
            if (folder / name).exists():
                recordings.append(clips.of_recording(folder / name, protocol.windows_recording))
            else:
                print(f"left out: there is no {folder / name}")
        seed = (protocol.seed_test,)
        return cls(
            scenes(protocol.train, protocol.seeds_train), scenes(protocol.train, seed), scenes(protocol.test, seed), recordings
        )

    def sources(self) -> list[dict[str, Any]]:
        """Returns what the record says of the clips that are measured on."""
        made = []
        for of, found in (("seen", self.seen), ("unseen", self.unseen), ("recordings", self.recordings)):
            for clip in found:
                moving = None if clip.masks is None else float(clip.masks.mean())
                made.append(
                    {
                        "set": of,
                        "source": clip.name,
                        "sensor": list(clip.sensor),
                        "windows": clip.count,
                        "events": len(clip.events),
                        "moving": moving,
                    }
                )
        return made


def agreement(masks: Any, wanted: Any) -> list[Union[float, None]]:
    """Returns for each network the intersection over the union of all windows; None if there are no pixels in either, or
    none that is wanted."""
    found: list[Union[float, None]] = []
    for mask, other in zip(masks, wanted):
        union = int((mask | other).sum())
        found.append(int((mask & other).sum()) / union if union and other.any() else None)
    return found


def measured(protocol: Protocol, data: Clips, thresholds: Path, name: str, m: int) -> list[dict[str, Any]]:
    """Trains the networks of an input, and returns the rows of the record."""
    torch.set_num_threads(1)
    channels = inputs.channels(name, m)
    samples = [inputs.arrays(name, m, clip, thresholds=thresholds)[0] for clip in data.train]
    flat = [sample for of_clip in samples for sample in of_clip]
    scale = network.scale_of(flat, channels)
    nets = [network.train(data.train, samples, channels, scale, protocol.steps, seed) for seed in protocol.seeds]
    rows = []
    originals: dict[str, Any] = {}

    def row(of: str, coded: str, setting: inputs.Setting, clip: Clip) -> None:
        made, size = inputs.arrays(coded, m, clip, setting, thresholds)
        masks = network.masks(nets, made, clip.sensor, scale)
        if clip.masks is not None:
            wanted = np.broadcast_to(clip.masks, masks.shape)
        elif setting is None:
            originals[clip.name] = masks
            return
        else:
            wanted = originals[clip.name]
        rows.append(
            {
                "input": coded,
                "m": m,
                "setting": setting,
                "set": of,
                "source": clip.name,
                "bits": None if setting is None else round(8 * size / len(clip.events), 3),
                "iou": [None if iou is None else round(iou, 4) for iou in agreement(masks, wanted)],
                "marked": [round(float(mask.mean()), 6) for mask in masks],
            }
        )

    everything = (("seen", data.seen), ("unseen", data.unseen), ("recordings", data.recordings))
    for of, found in everything:
        for clip in found:
            row(of, name, None, clip)
    # Its coefficients are those of the DCT, sent otherwise: the networks are the same.
    for coded in (name, "best") if name == "dct" else (name,):
        for setting in protocol.settings(coded) if m in (*protocol.m_coded, 2) else ():
            for of, found in everything:
                for clip in found:
                    row(of, coded, setting, clip)
    return rows


_DATA: dict[str, Any] = {}


def _start(folder: str) -> None:
    """Begins a process: reads the clips."""
    _DATA["clips"] = pickle.loads((Path(folder) / "clips").read_bytes())
    _DATA["thresholds"] = Path(folder) / "thresholds.toml"


def _work(protocol: Protocol, name: str, m: int) -> list[dict[str, Any]]:
    return measured(protocol, _DATA["clips"], _DATA["thresholds"], name, m)


def _write(path: Path, text: str) -> None:
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def _part(protocol: Protocol, folder: Path, name: str, m: int) -> tuple[Path, Any]:
    """Returns the file of a job's rows, and the rows if they are there and of this protocol."""
    path = folder / f"part-{name}-{m}.json"
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return path, None
    return path, found["rows"] if found["protocol"] == json.loads(json.dumps(asdict(protocol))) else None


def cpu() -> str:
    """Returns the processor's name, if the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.split(": ", 1)[1] for line in lines if line.startswith("model name")), platform.machine())


def all_rows(protocol: Protocol, data: Clips, folder: Path, processes: int) -> list[dict[str, Any]]:
    """Does what is left of the jobs, and returns all rows in the order of the jobs."""
    jobs = protocol.jobs()
    left = [job for job in jobs if _part(protocol, folder, *job)[1] is None]
    print(f"{len(jobs)} inputs and M, {len(jobs) - len(left)} of them done before", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "clips").write_bytes(pickle.dumps(data))
        low, high = clips.thresholds_of(data.train)
        (Path(scratch) / "thresholds.toml").write_text(f"tau_low = {low:.12f}\ntau_high = {high:.12f}\n")
        with ProcessPoolExecutor(
            processes, multiprocessing.get_context("spawn"), initializer=_start, initargs=(scratch,)
        ) as pool:
            running = {pool.submit(_work, protocol, *job): job for job in left}
            begin = time.perf_counter()
            for count, ended in enumerate(as_completed(running), 1):
                job = running[ended]
                rows = ended.result()
                _write(_part(protocol, folder, *job)[0], json.dumps({"protocol": asdict(protocol), "rows": rows}))
                seconds = time.perf_counter() - begin
                print(f"{count}/{len(left)} {job[0]}, M = {job[1]}: {seconds:.0f} s since the begin", flush=True)
    return [row for job in jobs for row in _part(protocol, folder, *job)[1]]


def main() -> int:
    arguments = parser.parse_args()
    folder: Path = arguments.output
    target = folder / "record.json"
    if target.exists() and not arguments.overwrite:
        parser.error(f"{target} is there: name another folder, or replace it with --overwrite")
    if arguments.save is not None:
        report.check_marks(arguments.save)
    protocol = QUICK if arguments.quick else Protocol()
    if arguments.coded_m is not None:
        protocol = replace(protocol, m_coded=tuple(arguments.coded_m))
    folder.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    data = Clips.of(protocol, arguments.recordings)
    left = []
    if arguments.so_far:
        done = [(job, _part(protocol, folder, *job)[1]) for job in protocol.jobs()]
        left = [job for job, rows in done if rows is None]
        rows = [row for _, rows in done for row in rows or ()]
    else:
        rows = all_rows(protocol, data, folder, max(1, arguments.processes))
    record = {
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "machine": f"{cpu()}, {os.cpu_count()} cores, {arguments.processes} processes",
        "torch": torch.__version__,
        "seconds": None if arguments.so_far else round(time.perf_counter() - begin),
        "left": left,
        "protocol": json.loads(json.dumps(asdict(protocol))),
        "thresholds": [round(tau, 3) for tau in clips.thresholds_of(data.train)],
        "sources": data.sources(),
        "rows": rows,
    }
    record = json.loads(json.dumps(record))
    _write(target, report.text_of(record))
    _write(folder / "iou.svg", chart.chart(record))
    for job in protocol.jobs() if not left else ():
        _part(protocol, folder, *job)[0].unlink()
    lines = report.lines(record)
    print("\n".join(lines))
    if arguments.save is not None:
        report.put(lines, arguments.save)
    return 0


if __name__ == "__main__":
    sys.exit(main())
