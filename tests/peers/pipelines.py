"""Events per second that recordings are converted with, by eecvs and by other libraries.

    python tests/peers/pipelines.py EECVS RECORDING FOLDER [--rounds N] [--record FILE]

EECVS is the command, RECORDING a recording that is repeated to some six million events, FOLDER where it is made in every
format. `cargo xtask pipelines` installs the libraries and calls this. Outputs go to memory (/dev/shm) where that is
there, so that no disk is measured. In every round each library converts each pair of formats that it knows once, in a
process of its own and on one processor; the best of all rounds is its figure. eecvs converts again on all processors
where the output is compressed. An output of another library has to give as many events as that of eecvs.
"""

import argparse
import importlib
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

import speed_record

EVENTS = 6_000_000
# Converted to each other by eecvs and faery.
FORMATS = ["dat", "evt2", "evt3", "es", "csv", "aedat4"]
# Converted from and to DAT by eecvs alone.
OTHERS = ["npz", "hdf5", "parquet", "mcap"]
COMPRESSED = ["aedat4", "npz", "hdf5", "mcap"]
ENDINGS = {"evt2": "evt2.raw", "evt3": "evt3.raw", "hdf5": "h5"}


def name(format):
    return f"events.{ENDINGS.get(format, format)}"


def by_faery(source, to, output):
    import faery

    options = {"version": to} if to in ("evt2", "evt3") else {}
    faery.events_stream_from_file(source).to_file(output, zero_t0=False, **options)


def by_expelliarmus(source, to, output):
    from expelliarmus import Wizard

    source = pathlib.Path(source)
    of = next(format for format in FORMATS if source.name == name(format))
    events = Wizard(encoding=of, fpath=str(source)).read()
    Wizard(encoding=to).save(fpath=output, arr=events)


def by_dv_processing(source, to, output):
    import dv_processing as dv

    reader = dv.io.MonoCameraRecording(source)
    config = dv.io.MonoCameraWriter.EventOnlyConfig("eecvs", reader.getEventResolution())
    writer = dv.io.MonoCameraWriter(output, config)
    while (events := reader.getNextEventBatch()) is not None:
        writer.writeEvents(events)


LIBRARIES = {
    "faery": (FORMATS, by_faery),
    "expelliarmus": (["dat", "evt2", "evt3"], by_expelliarmus),
    "dv-processing": (["aedat4"], by_dv_processing),
}


def one(library, source, to, output):
    """Seconds of a conversion in this process, in which the library is loaded before."""
    _, convert = LIBRARIES[library]
    importlib.import_module(library.replace("-", "_"))
    start = time.perf_counter()
    convert(source, to, output)
    return time.perf_counter() - start


def of_library(library, source, to, output):
    run = [sys.executable, __file__, "--one", library, str(source), to, str(output)]
    done = subprocess.run(run, capture_output=True, text=True)
    if done.returncode != 0:
        return None, (done.stderr.strip().splitlines() or ["failed"])[-1]
    return float(done.stdout), None


def of_eecvs(eecvs, source, to, scratch):
    run = [eecvs, "bench", "--quick", "--pipelines", str(source), "--to", to, "--json"]
    environment = {**os.environ, "TMPDIR": str(scratch)}
    out = subprocess.run(run, check=True, capture_output=True, text=True, env=environment).stdout
    (row,) = json.loads(out)
    return row


def count(eecvs, file):
    # Some files of other libraries do not state the sensor's size.
    info = [eecvs, "info", str(file), "--json", "--width", "2048", "--height", "2048"]
    out = subprocess.run(info, capture_output=True, text=True)
    return json.loads(out.stdout)["events"] if out.returncode == 0 else None


def make(eecvs, recording, folder):
    """The recording, repeated, in every format."""
    import numpy as np

    columns, dat = folder / "once.npz", folder / name("dat")
    subprocess.run([eecvs, "convert", str(recording), str(columns), "--overwrite"], check=True, capture_output=True)
    events = np.load(columns)
    t, x, y, p = (events[key].astype("<u8") for key in "txyp")
    t -= t.min()
    span = t.max() + 1
    with open(dat, "wb") as file:
        header = f"% Version 2\n% Width {int(events['width'])}\n% Height {int(events['height'])}\n"
        file.write(header.encode() + bytes([12, 8]))
        for i in range(-(-EVENTS // len(t))):
            file.write((t + span * np.uint64(i) | x << 32 | y << 46 | p << 60).tobytes())
    for format in FORMATS + OTHERS:
        if format != "dat":
            form = ["--format", format, "--overwrite"]
            subprocess.run([eecvs, "convert", str(dat), str(folder / name(format)), *form], check=True, capture_output=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("eecvs")
    parser.add_argument("recording", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--record", type=pathlib.Path)
    options = parser.parse_args()
    eecvs, folder = options.eecvs, options.folder

    make(eecvs, options.recording, folder)
    pairs = [(a, b) for a in FORMATS for b in FORMATS]
    pairs += [("dat", to) for to in OTHERS] + [(of, "dat") for of in OTHERS]
    memory = pathlib.Path("/dev/shm")
    scratch = pathlib.Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else folder))
    all_processors = os.sched_getaffinity(0)
    best, left_out = {}, {}
    try:
        for _ in range(options.rounds):
            for of, to in pairs:
                source, output = folder / name(of), scratch / name(to)
                os.sched_setaffinity(0, {max(all_processors)})
                row = of_eecvs(eecvs, source, to, scratch)
                figures = {("eecvs", 1): row["seconds"]}
                for library, (formats, _) in LIBRARIES.items():
                    if of in formats and to in formats and (library, of, to) not in left_out:
                        seconds, why = of_library(library, source, to, output)
                        if why is None and (found := count(eecvs, output)) != row["events"]:
                            why = f"gives {found} events of {row['events']}"
                        output.unlink(missing_ok=True)
                        if why is not None:
                            left_out[library, of, to] = why
                            continue
                        figures[library, 1] = seconds
                os.sched_setaffinity(0, all_processors)
                if to in COMPRESSED and len(all_processors) > 1:
                    several = of_eecvs(eecvs, source, to, scratch)
                    figures["eecvs", len(all_processors)] = several["seconds"]
                for (library, threads), seconds in figures.items():
                    key = (of, to, library, threads)
                    best[key] = min(seconds, best.get(key, (seconds, 0))[0]), row["events"]
    finally:
        shutil.rmtree(scratch)

    for (library, of, to), why in left_out.items():
        print(f"left out: {library}, {of} to {to}: {why}", file=sys.stderr)
    print(f"million events per second, the best of {options.rounds} rounds")
    rows = []
    for (of, to, library, threads), (seconds, events) in best.items():
        print(f"{of:<8} {to:<8} {library:<14} {threads} {events / seconds / 1e6:8.1f}")
        rows.append({"from": of, "to": to, "library": library, "threads": threads, "events": events,
                     "seconds": seconds})
    if options.record:
        speed_record.write(options.record, eecvs, rows, f"{os.cpu_count()} threads")


if sys.argv[1:2] == ["--one"]:
    print(one(*sys.argv[2:6]))
else:
    main()
