"""Emulated against real events: `eecvs emulate` and v2e on the frames of DAVIS recordings.

    python tests/peers/emulators.py EECVS V2E RECORDING.aedat4 [...] [--write docs/emulator.md] [--fits FITS.json]

EECVS is the command and V2E a folder with the source of v2e (https://github.com/SensorsINI/v2e). numpy, torch, OpenCV
with its optical flow, and the package aedat, which reads the frames, have to be installed, and h5py, tqdm, numba,
Pillow, argcomplete, dv_processing and engineering_notation, which v2e imports; of what v2e shows on a screen nothing is
loaded. Without them, the script exits with 77. docs/emulator.md has the columns' formulas.

Both emulators get the same frames, as 16-bit numbers at the middle of their exposure: those of the recording, and
those with frames in between, RATE a second, by optical flow.

The protocol, which was fixed before any of its results was seen:

1. Each emulator is fitted to the real events of the first half of the recording's frames, to the last intervals of it
   that have at most FIT_FRAMES frames to emulate. The objective is the sum of three numbers (`distance`): the distance
   of rates per pixel and polarity, the Wasserstein-1 distance of the logarithms of intervals in decades, and |log10| of
   the ratio of the numbers of events.
2. Both change the same seven parameters, from their defaults on: two thresholds and their spread, bandwidth, noise,
   leakage, refractory time. A fit is BUDGET emulations by `fit`, the same for both, with the same random numbers.
3. This is done with each of SEEDS. What is best on the first half is the fit; of all of them, the second half's
   distances are shown.
4. Judged are the two stated distances, of rates per pixel and of intervals, on the second half, which no fit has seen.
   An emulation begins an interval of the recording's frames before the events that are compared, where there is one.

Seconds are those of one core (user and system), the least of RUNS runs: of eecvs for the whole process, from reading
the frames to the written recording; of v2e for its class EventEmulator alone, on one thread, without loading torch and
without output; and of both commands from a folder of PNG to a file of HDF5.
"""

import argparse
import concurrent.futures
import json
import logging
import multiprocessing
import os
import pathlib
import re
import resource
import runpy
import shutil
import subprocess
import sys
import tempfile
import time
from unittest import mock

import comparison
import speed_record
from comparison import events, np, package

RATE = 1000
# Frames that each emulation of a fit has, at most.
FIT_FRAMES = 125
# Emulations of each fit, and how many times smaller or larger its parameters at random are than at the start.
BUDGET = 40
REACH = 6
# Fits of each emulator, whose random numbers begin with these.
SEEDS = (1, 2, 3)
# Fits at a time, and runs whose least time counts.
WORKERS = 2
RUNS = 1
# Side of the blocks of pixels whose rates are compared.
BLOCK = 4
NEIGHBOUR_US = 5_000
# Pixels that are white in every frame, and those so near to them, are left out: the frames do not show their light.
GLARE = 8
WHITE = 65_535

# v2e's own defaults, as those of its command (v2ecore/v2e_args.py).
V2E_DEFAULTS = {
    "pos_thres": 0.2,
    "neg_thres": 0.2,
    "sigma_thres": 0.03,
    "cutoff_hz": 300,
    "leak_rate_hz": 0.01,
    "shot_noise_rate_hz": 0.001,
    "refractory_period_s": 0.0005,
}
# Where each fit begins, and the parameters that it changes, the same of both emulators: thresholds and their spread,
# bandwidth, noise, leakage and refractory time.
V2E_START = {
    "pos_thres": 0.2,
    "neg_thres": 0.2,
    "sigma_thres": 0.03,
    "cutoff_hz": 300.0,
    "shot_noise_rate_hz": 0.1,
    "leak_rate_hz": 0.1,
    "refractory_period_s": 0.0005,
}
V2E_RANGE = {"sigma_thres": (0.001, 0.1), "cutoff_hz": (1, 10_000)}
OURS_START = {
    "threshold-on": 0.25,
    "threshold-off": 0.27,
    "threshold-spread": 0.08,
    "corner-hz-per-lux": 3.0,
    "shot-noise": 0.085,
    "leak-hz": 0.1,
    "refractory-us": 300.0,
}
OURS_RANGE = {"threshold-spread": (0.005, 0.3)}


class Recording:
    """Frames of 16 bits, their times in us since the first one, and the events in between."""

    def __init__(self, path):
        self.name = path.parent.name
        aedat = package("aedat")
        found = [packet["frame"] for packet in aedat.Decoder(str(path)) if "frame" in packet]
        t = np.array([(int(f["exposure_begin_t"]) + int(f["exposure_end_t"])) // 2 for f in found])
        self.frames = np.stack([f["pixels"].astype(np.uint16) * (WHITE // 255) for f in found])
        real = comparison.ours(path)
        real = real[(real["t"] >= t[0]) & (real["t"] < t[-1])]
        real["t"] -= np.uint64(t[0])
        self.times, self.size = t - t[0], (self.frames.shape[2], self.frames.shape[1])
        white = np.pad((self.frames == WHITE).all(0), GLARE)
        around = np.lib.stride_tricks.sliding_window_view(white, (2 * GLARE + 1,) * 2)
        self.is_seen = ~around.any((2, 3))
        self.half = len(self.times) // 2
        self.seen_share = self.is_seen[real["y"], real["x"]].mean()
        self.real = self.seen(real)

    def interval_us(self):
        return (self.times[-1] - self.times[0]) / (len(self.times) - 1)

    def seen(self, array):
        """The events of pixels that the frames show."""
        return array[self.is_seen[array["y"], array["x"]]]

    def video(self, first, last, rate):
        """Frames from the interval before `first` to `last`, at their times, with frames in between."""
        first = max(first - 1, 0)
        frames, times = self.frames[first : last + 1], self.times[first : last + 1]
        if rate is not None:
            frames, times = between(frames, times, rate)
        return frames, times

    def window(self, array, first, last):
        array = self.seen(array)
        return array[(array["t"] >= self.times[first]) & (array["t"] < self.times[last])]


def between(frames, times, rate):
    """Frames in between by the dense optical flow of OpenCV (DIS), from both sides."""
    import cv2

    cv2.setNumThreads(1)
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    rows, columns = np.mgrid[: frames.shape[1], : frames.shape[2]].astype(np.float32)

    def moved(frame, x, y):
        return cv2.remap(frame, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)

    out, at = [frames[0]], [times[0]]
    for a, b, start, end in zip(frames, frames[1:], times, times[1:]):
        dx, dy = np.moveaxis(flow.calc((a >> 8).astype(np.uint8), (b >> 8).astype(np.uint8), None), 2, 0)
        before, after = a.astype(np.float32), b.astype(np.float32)
        steps = max(round((end - start) * rate / 1e6), 1)
        for i in range(1, steps):
            w = i / steps
            early = moved(before, columns - w * dx, rows - w * dy)
            late = moved(after, columns + (1 - w) * dx, rows + (1 - w) * dy)
            out.append(np.rint((1 - w) * early + w * late).astype(np.uint16))
            at.append(start + round((end - start) * w))
        out.append(b)
        at.append(end)
    return np.stack(out), np.array(at)


def without_windows():
    """Stands in for what v2e loads to show windows, to read dialogs and to interpolate by its network."""
    for name in ("tkinter", "tkinter.filedialog", "easygui", "screeninfo", "gooey", "torchvision", "torchvision.transforms"):
        sys.modules[name] = mock.MagicMock()
    sys.modules["v2ecore.desktop"] = mock.MagicMock()


def emulator_class(folder):
    without_windows()
    sys.path.insert(0, str(folder))
    import torch

    torch.set_num_threads(1)
    logging.disable(logging.WARNING)
    from v2ecore.emulator import EventEmulator

    return EventEmulator


def v2e_command(folder, *arguments):
    """v2e's command in this process."""
    without_windows()
    sys.path.insert(0, folder)
    sys.argv = ["v2e.py", *arguments]
    runpy.run_path(str(pathlib.Path(folder) / "v2e.py"), run_name="__main__")


def children_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def command_seconds(video, folder, v2e):
    """Seconds of both commands, from a folder of PNG to a file of events."""
    import cv2

    frames, times = video
    pictures = folder / "pictures"
    shutil.rmtree(pictures, ignore_errors=True)
    pictures.mkdir()
    for number, frame in enumerate(frames):
        cv2.imwrite(str(pictures / f"{number:06}.png"), (frame >> 8).astype(np.uint8))
    rate = (len(times) - 1) / (times[-1] - times[0]) * 1e6
    start = children_seconds()
    comparison.eecvs_run("emulate", pictures, "--fps", f"{rate:.6f}", "--response", "linear", "--threads", 1, "-o",
                         folder / "command.h5", "--overwrite")
    ours = children_seconds() - start
    height, width = frames.shape[1:]
    options = ["-i", pictures, "--input_frame_rate", rate, "--disable_slomo", "-o", folder / "v2e", "--overwrite",
               "--no_preview", "--skip_video_output", "--dvs_h5", "events", "--output_width", width, "--output_height",
               height]
    start = children_seconds()
    run = [sys.executable, __file__, "--v2e-command", v2e, *options]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run([str(word) for word in run], capture_output=True, text=True, env=environment)
    if done.returncode != 0 or not (folder / "v2e" / "events.h5").exists():
        sys.exit(f"v2e's command: {done.stdout}{done.stderr}")
    return ours, children_seconds() - start


def by_v2e(video, parameters, preset=None):
    frames, times = video
    frames = frames.astype(np.float32) * np.float32(255 / WHITE)
    emulator = EventEmulator(device="cpu", seed=1, **{**V2E_DEFAULTS, **parameters})
    if preset:
        emulator.set_dvs_params(preset)
    start, parts = time.process_time(), []
    for frame, t_us in zip(frames, times):
        part = emulator.generate_events(frame, (t_us - times[0]) / 1e6)
        if part is not None:
            parts.append(part)
    seconds = time.process_time() - start
    array = np.concatenate(parts) if parts else np.zeros((0, 4))
    t = np.rint(array[:, 0].astype(np.float64) * 1e6).astype(np.int64) + times[0]
    array = events(t, array[:, 1], array[:, 2], array[:, 3])
    return array[np.argsort(array["t"], kind="stable")], seconds


def by_eecvs(video, parameters, folder):
    frames, times = video
    source, stamps, out = folder / "video.npy", folder / "times.txt", folder / "emulated.npz"
    if by_eecvs.written is not frames:
        np.save(source, frames)
        stamps.write_text("".join(f"{t_us}\n" for t_us in times))
        by_eecvs.written = frames
    options = ["--times", stamps, "--time-unit", "us", "--response", "linear", "--threads", 1]
    options += [word for name, value in parameters.items() for word in (f"--{name}", repr(float(value)))]
    start = children_seconds()
    comparison.eecvs_run("emulate", source, "-o", out, "--overwrite", *options)
    seconds = children_seconds() - start
    with np.load(out) as arrays:
        return events(*(arrays[name] for name in "txyp")), seconds


by_eecvs.written = None


def counts(array, size, block):
    """Events per block of pixels and polarity."""
    columns, rows = -(-size[0] // block), -(-size[1] // block)
    index = (array["p"].astype(np.int64) * rows + array["y"] // block) * columns + array["x"] // block
    return np.bincount(index, minlength=2 * rows * columns).astype(float)


def rate_distance(a, b, size, block):
    a, b = counts(a, size, block), counts(b, size, block)
    return np.abs(a - b).sum() / max(a.sum() + b.sum(), 1)


def rate_correlation(a, b, size, block):
    a, b = counts(a, size, block), counts(b, size, block)
    return np.corrcoef(a, b)[0, 1] if a.std() and b.std() else 0.0


def log_intervals(array, size):
    """log10 of the time in us between an event and the one before of its pixel and polarity, at least 1 us."""
    pixel = (array["y"].astype(np.int64) * size[0] + array["x"]) * 2 + array["p"]
    order = np.lexsort((array["t"], pixel))
    pixel, t = pixel[order], array["t"][order].astype(np.int64)
    same = pixel[1:] == pixel[:-1]
    return np.log10(np.maximum(np.diff(t)[same], 1))


def wasserstein(a, b):
    """Wasserstein-1 distance of two samples: the area between their distributions."""
    if not len(a) or not len(b):
        return np.inf
    a, b = np.sort(a), np.sort(b)
    at = np.sort(np.concatenate((a, b)))
    share = [np.searchsorted(of, at[:-1], side="right") / len(of) for of in (a, b)]
    return float(np.sum(np.abs(share[0] - share[1]) * np.diff(at)))


def interval_distance(a, b, size):
    return wasserstein(log_intervals(a, size), log_intervals(b, size))


def neighbours(array, size):
    """Share of events before which one of the eight neighbouring pixels had an event within NEIGHBOUR_US."""
    if not len(array):
        return 0.0
    t = array["t"].astype(np.int64)
    t = t - t.min()
    span = int(t.max()) + 2 * NEIGHBOUR_US
    width = size[0] + 2
    pixel = (array["y"].astype(np.int64) + 1) * width + array["x"] + 1
    key = np.sort(pixel * span + t)
    is_near = np.zeros(len(array), bool)
    for dy in (-width, 0, width):
        for dx in (-1, 0, 1):
            if dx or dy:
                near = (pixel + dy + dx) * span + t
                is_near |= np.searchsorted(key, near, "right") > np.searchsorted(key, near - NEIGHBOUR_US, "left")
    return float(is_near.mean())


def bits(array, size, folder):
    if not len(array):
        return float("nan")
    source, out = folder / "encode.npz", folder / "encode.eecvs"
    p = array["p"].astype(np.uint8)
    np.savez(source, x=array["x"], y=array["y"], t=array["t"].astype(np.int64), p=p, width=size[0], height=size[1])
    comparison.eecvs_run("encode", source, "-o", out, "--overwrite", "--coder", "dense", "--json")
    return 8 * out.stat().st_size / len(array)


def distance(real, got, size):
    """The objective of a fit: the distances of rates per pixel and of intervals, and that of the numbers of events. The
    latter two are in decades."""
    number = abs(np.log10(max(len(got), 1) / max(len(real), 1)))
    return rate_distance(real, got, size, 1) + min(interval_distance(real, got, size), 10.0) + number


def fit(start, ranges, objective, seed):
    """The best of BUDGET emulations, and its objective. Half of them have parameters at random, evenly in their
    logarithms, up to REACH times smaller or larger than at the start. Then each parameter of the best in turn is
    multiplied or divided by a step, and what is better is kept; the step is 2, and its square root after each turn."""
    random = np.random.default_rng(seed)

    def limited(parameters):
        within = {name: np.clip(value, *ranges.get(name, (0, np.inf))) for name, value in parameters.items()}
        return {name: float(f"{value:.3g}") for name, value in within.items()}

    least, best = objective(start), dict(start)
    for _ in range(1, BUDGET // 2):
        factors = REACH ** random.uniform(-1, 1, len(start))
        tried = limited({name: value * factor for (name, value), factor in zip(start.items(), factors)})
        found = objective(tried)
        if found < least:
            least, best = found, tried
    runs, step = BUDGET // 2, 2.0
    while runs < BUDGET:
        for name in start:
            for factor in (step, 1 / step):
                if runs == BUDGET:
                    break
                tried = limited({**best, name: best[name] * factor})
                found = objective(tried)
                runs += 1
                if found < least:
                    least, best = found, tried
                    break
        step = step**0.5
    return least, best


EMULATORS = {"eecvs": (OURS_START, OURS_RANGE), "v2e": (V2E_START, V2E_RANGE)}


def fitted(job):
    """The fit of one emulator to the first half of a recording."""
    recording, rate, emulator, seed = job
    half = recording.half
    steps = 1 if rate is None else max(round(recording.interval_us() * rate / 1e6), 1)
    first = max(half - max(FIT_FRAMES // steps - 1, 1), 0)
    video, size = recording.video(first, half, rate), recording.size
    real = recording.window(recording.real, first, half)
    with tempfile.TemporaryDirectory() as folder:

        def objective(parameters):
            if emulator == "eecvs":
                got = by_eecvs(video, parameters, pathlib.Path(folder))[0]
            else:
                got = by_v2e(video, parameters)[0]
            return distance(real, recording.window(got, first, half), size)

        start, ranges = EMULATORS[emulator]
        least, best = fit(start, ranges, objective, seed)
    print(f"fitted {emulator}, {recording.name}, {label_of(rate)}, seed {seed}: {least:.3f} {best}", flush=True)
    return least, best


def all_fits(recordings, path):
    """The fits by recording, rate and emulator, the best first. The longest ones are begun first. A file `path` keeps
    them, and gives them back where it is there: they do not depend on the machine."""
    jobs = [
        (recording, rate, emulator, seed)
        for rate in (RATE, None)
        for emulator in ("v2e", "eecvs")
        for recording in sorted(recordings, key=lambda recording: -len(recording.times))
        for seed in SEEDS
    ]
    if path is not None and path.exists():
        results = json.loads(path.read_text())
        return grouped(jobs, results)
    fork = multiprocessing.get_context("fork")
    with concurrent.futures.ProcessPoolExecutor(WORKERS, mp_context=fork) as pool:
        results = list(pool.map(fitted, jobs))
    if path is not None:
        path.write_text(json.dumps(results))
    return grouped(jobs, results)


def grouped(jobs, results):
    fits = {}
    for (recording, rate, emulator, _), result in zip(jobs, results):
        fits.setdefault((recording.name, rate, emulator), []).append(result)
    return {key: sorted(found, key=lambda pair: pair[0]) for key, found in fits.items()}


def label_of(rate):
    return "own frames" if rate is None else f"{rate} frames/s"


def measured(recording, array, real):
    """The numbers of a row."""
    size = recording.size
    return {
        "rate": rate_distance(real, array, size, 1),
        "blocks": rate_distance(real, array, size, BLOCK),
        "correlation": rate_correlation(real, array, size, BLOCK),
        "intervals": interval_distance(real, array, size),
    }


def row(label, recording, array, folder, span_us, numbers=None, seconds=None, others=()):
    """A row of the table; `others` are the numbers of further fits, whose span is shown."""
    size = recording.size
    cells = [label, f"{len(array) / span_us * 1e6:,.0f}", f"{array['p'].mean() if len(array) else 0:.2f}"]
    for name, digits in (("rate", 3), ("blocks", 3), ("correlation", 2), ("intervals", 3)):
        if numbers is None:
            cells.append("")
            continue
        cell = f"{numbers[name]:.{digits}f}"
        if others:
            values = [of[name] for of in (numbers, *others)]
            cell += f" ({min(values):.{digits}f} to {max(values):.{digits}f})"
        cells.append(cell)
    cells += [f"{neighbours(array, size):.2f}", f"{bits(array, size, folder):.1f}"]
    cells.append("" if seconds is None else f"{seconds:.2f}")
    line = "| " + " | ".join(cells) + " |"
    print(line, flush=True)
    return line


HEAD = [
    "emulator",
    "events/s",
    "ON",
    "rate, pixels",
    f"rate, {BLOCK} x {BLOCK}",
    "correlation",
    "intervals",
    "neighbours",
    "bits/event",
    "seconds",
]
VERDICTS = [
    "recording",
    "frames",
    "rate, pixels: eecvs",
    "v2e",
    "intervals: eecvs",
    "v2e",
    "v2e's class takes, of eecvs' command",
    "v2e's command takes, of eecvs' command",
]


def least_seconds(run):
    """What a run returns, and the least seconds of several."""
    results = [run() for _ in range(RUNS)]
    return results[0][0], min(seconds for _, seconds in results)


def compare(recording, rate, fits, folder, v2e):
    """The table of a recording at a rate of frames, and its row of the verdicts."""
    half, last = recording.half, len(recording.times) - 1
    span_us = recording.times[last] - recording.times[half]
    real = recording.window(recording.real, half, last)
    video = recording.video(half, last, rate)
    lines = [
        "",
        f"**{recording.name}, {label_of(rate)}**: {len(video[0])} frames, of which {span_us / 1e6:.2f} s are compared;"
        f" {100 * recording.seen_share:.0f} % of the real events are of pixels that the frames show.",
        "",
        "| " + " | ".join(HEAD) + " |",
        "|---" * len(HEAD) + "|",
        row("real", recording, real, folder, span_us),
    ]
    best = {}

    def add(label, runs):
        """Adds the row of the first of several runs, the others beside it."""
        numbers = []
        for number, run in enumerate(runs):
            array, seconds = least_seconds(run) if number == 0 else run()
            array = recording.window(array, half, last)
            numbers.append(measured(recording, array, real))
            if number == 0:
                first = (array, seconds)
        lines.append(row(label, recording, first[0], folder, span_us, numbers[0], first[1], numbers[1:]))
        best[label] = (numbers[0], first[1])

    ours, theirs = (fits[recording.name, rate, emulator] for emulator in ("eecvs", "v2e"))
    add("eecvs, its defaults", [lambda: by_eecvs(video, {}, folder)])
    add("eecvs, fitted", [lambda p=p: by_eecvs(video, p, folder) for _, p in ours])
    add("v2e, its defaults", [lambda: by_v2e(video, {})])
    add("v2e, `clean`", [lambda: by_v2e(video, {}, "clean")])
    add("v2e, `noisy`", [lambda: by_v2e(video, {}, "noisy")])
    add("v2e, fitted", [lambda p=p: by_v2e(video, p) for _, p in theirs])
    commands = [command_seconds(video, folder, v2e) for _ in range(RUNS)]
    ours_s, theirs_s = (min(seconds) for seconds in zip(*commands))
    lines += [
        "",
        f"The commands, from a folder of PNG to HDF5: eecvs {ours_s:.2f} s, v2e {theirs_s:.2f} s.",
        "",
        f"Fitted: `{shown(ours[0][1], '--')}`; v2e `{shown(theirs[0][1], '--')}`.",
    ]
    (mine, mine_s), (other, other_s) = best["eecvs, fitted"], best["v2e, fitted"]
    verdict = [
        recording.name,
        label_of(rate),
        f"{mine['rate']:.3f}",
        f"{other['rate']:.3f}",
        f"{mine['intervals']:.3f}",
        f"{other['intervals']:.3f}",
        f"{other_s / mine_s:.1f} times the time",
        f"{theirs_s / ours_s:.0f} times the time",
    ]
    return lines, "| " + " | ".join(verdict) + " |"


def shown(parameters, dashes):
    return " ".join(f"{dashes}{name} {value:g}" for name, value in parameters.items())


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("eecvs")
    parser.add_argument("v2e", type=pathlib.Path)
    parser.add_argument("recordings", type=pathlib.Path, nargs="+")
    parser.add_argument("--write", type=pathlib.Path)
    parser.add_argument("--fits", type=pathlib.Path)
    options = parser.parse_args()
    comparison.eecvs = options.eecvs
    if None in [package(name) for name in ("aedat", "cv2", "h5py", "torch", "PIL", "tqdm", "numba", "dv_processing")]:
        sys.exit(77)
    global EventEmulator
    EventEmulator = emulator_class(options.v2e)
    import torch

    version = re.search(r'version="(.*)"', (options.v2e / "setup.py").read_text()).group(1)
    recordings = [Recording(path) for path in options.recordings]
    fits = all_fits(recordings, options.fits)
    tables = []
    verdicts = ["| " + " | ".join(VERDICTS) + " |", "|---" * len(VERDICTS) + "|"]
    with tempfile.TemporaryDirectory() as folder:
        for recording in recordings:
            for rate in (None, RATE):
                table, verdict = compare(recording, rate, fits, pathlib.Path(folder), options.v2e)
                tables += table
                verdicts.append(verdict)
    head = f"v2e {version} with torch {torch.__version__}, each emulator on one core of: {speed_record.processor()}. "
    lines = [head + "The fits, on the second half:", "", *verdicts, *tables]
    text = "\n".join(lines).strip() + "\n"
    print(text)
    if options.write:
        page = options.write.read_text()
        begin, end = "<!-- reality: ", "<!-- reality end -->"
        start = page.index("\n", page.index(begin)) + 1
        options.write.write_text(page[:start] + text + page[page.index(end) :])


if __name__ == "__main__":
    if sys.argv[1:2] == ["--v2e-command"]:
        v2e_command(*sys.argv[2:])
    else:
        main()
