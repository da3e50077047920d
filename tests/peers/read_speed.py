"""Events per second that recordings are read with, by eecvs and by other libraries.

    python tests/peers/read_speed.py EECVS RECORDINGS FOLDER [--rounds N] [--record FILE]

EECVS is the command, RECORDINGS the folder of the shared recordings, FOLDER where larger ones are made.
`cargo xtask read-speed` installs the libraries and calls this. In every round each library reads each file
that it knows, seven times in a process of its own; the best of all rounds is its figure. A library that reads
either all at once or in parts counts with the quicker of the two. Every library has to give as many events as
eecvs.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import time

import speed_record

# As often as eecvs reads it.
REPETITIONS = 7
# Events of a file that is made larger.
EVENTS = 12_000_000
RECORDINGS = [
    "imx636_sparse_evt3/evt3.raw",
    "gen3_vga_dense_evt2/evt2.raw",
    "imx636_sparse_dat/gen4.dat",
    "davis346_static_sparse/davis346.aedat4",
    "dvxl_person_moderate/data_sample.aedat4",
]
# Repeated, in every format.
REPEATED = [("sparse", "imx636_sparse_evt3/evt3.raw"), ("dense", "gen3_vga_dense_evt2/evt2.raw")]
ENDINGS = ["evt3.raw", "evt2.raw", "dat", "aedat4"]


def format_of(file):
    """By the names that are used here."""
    return next(ending.removesuffix(".raw") for ending in ENDINGS if file.endswith(ending))


def read_faery(file):
    import faery

    yield lambda: sum(len(events) for events in faery.events_stream_from_file(file))


def read_aedat(file):
    import aedat

    # It unpacks frames too, where there are some.
    yield lambda: sum(len(packet["events"]) for packet in aedat.Decoder(file) if "events" in packet)


def read_expelliarmus(file):
    from expelliarmus import Wizard

    def wizard():
        return Wizard(encoding=format_of(file), fpath=file)

    def in_parts():
        reader = wizard()
        reader.set_chunk_size(1 << 14)
        return sum(len(events) for events in reader.read_chunk())

    yield lambda: len(wizard().read())
    yield in_parts


def read_evt3(file):
    import evt3

    yield lambda: len(evt3.decode_file(file))
    yield lambda: sum(len(events) for events in evt3.decode_file_batches(file))


LIBRARIES = {
    "faery": (["evt3", "evt2", "dat", "aedat4"], read_faery),
    "expelliarmus": (["evt3", "evt2", "dat"], read_expelliarmus),
    "evt3": (["evt3"], read_evt3),
    "aedat": (["aedat4"], read_aedat),
}


def measure(library, file):
    """Events and the least seconds of a library, in this process."""
    _, ways = LIBRARIES[library]
    best = None
    for way in ways(file):
        for _ in range(REPETITIONS):
            start = time.perf_counter()
            events = way()
            seconds = time.perf_counter() - start
            best = min(best or (seconds, events), (seconds, events))
    seconds, events = best
    return {"events": events, "seconds": seconds}


def of_library(library, file):
    run = [sys.executable, __file__, "--one", library, str(file)]
    return json.loads(subprocess.run(run, check=True, capture_output=True, text=True).stdout)


def of_eecvs(eecvs, file):
    run = [eecvs, "bench", "--read", str(file), "--json"]
    (row,) = json.loads(subprocess.run(run, check=True, capture_output=True, text=True).stdout)
    return {"events": row["events"], "seconds": row["seconds"]}


def larger(eecvs, recordings, folder):
    """The repeated recordings, made where they are not there yet."""
    import numpy as np

    for name, recording in REPEATED:
        files = [folder / f"{name}.{ending}" for ending in ENDINGS]
        if not all(file.exists() for file in files):
            columns = folder / f"{name}.npz"
            convert = [eecvs, "convert", str(recordings / recording), str(columns)]
            subprocess.run(convert, check=True, capture_output=True)
            info = subprocess.run(
                [eecvs, "info", str(recordings / recording), "--json"],
                check=True, capture_output=True, text=True,
            )
            info = json.loads(info.stdout)
            events = np.load(columns)
            t, x, y, p = (events[key].astype("<u8") for key in "txyp")
            t -= t.min()
            span = t.max() + 1
            dat = folder / f"{name}.dat"
            with open(dat, "wb") as file:
                header = f"% Version 2\n% Width {info['width']}\n% Height {info['height']}\n"
                file.write(header.encode() + bytes([12, 8]))
                for i in range(-(-EVENTS // len(t))):
                    file.write((t + span * np.uint64(i) | x << 32 | y << 46 | p << 60).tobytes())
            for file in files:
                if file != dat:
                    run = [eecvs, "convert", str(dat), str(file)]
                    subprocess.run(run, check=True, capture_output=True)
        yield from files


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("eecvs")
    parser.add_argument("recordings", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--record", type=pathlib.Path)
    options = parser.parse_args()

    files = [options.recordings / name for name in RECORDINGS]
    missing = [str(file) for file in files if not file.exists()]
    if missing:
        sys.exit(f"not there: {', '.join(missing)}")
    files += larger(options.eecvs, options.recordings, options.folder)
    best = {}
    for _ in range(options.rounds):
        for file in files:
            results = {"eecvs": of_eecvs(options.eecvs, file)}
            for library, (formats, _) in LIBRARIES.items():
                if format_of(file.name) in formats:
                    results[library] = of_library(library, file)
            for library, result in results.items():
                if result["events"] != results["eecvs"]["events"]:
                    sys.exit(f"{file}: {library} gives {result['events']} events, "
                             f"eecvs {results['eecvs']['events']}")
                row = best.setdefault((file.name, library), result)
                row["seconds"] = min(row["seconds"], result["seconds"])

    print(f"million events per second, the best of {options.rounds} rounds")
    rows = []
    for (file, library), row in best.items():
        rate = row["events"] / row["seconds"]
        print(f"{file:<20} {library:<12} {rate / 1e6:8.1f}")
        rows.append({"file": file, "library": library, **row})
    if options.record:
        speed_record.write(options.record, options.eecvs, rows, "1 thread")


if sys.argv[1:2] == ["--one"]:
    print(json.dumps(measure(sys.argv[2], sys.argv[3])))
else:
    main()
