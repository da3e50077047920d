"""Simulated cameras against the drivers of others: dv-processing, neuromorphic-drivers, libcaer.

    python tests/peers/cameras.py EECVS-USB

`eecvs-usb simulate MODEL RECORDING --run` serves each camera to this script, run again as

    python tests/peers/cameras.py --client DRIVER MODEL SECONDS FILE COUNT

which opens it by the driver, unmodified, writes the events to FILE, and prints what came as one line of JSON. Checked are
each event by its time since the first one, its pixel and its polarity; that the events before a silence, COUNT of them,
come in that silence, which they only do if the camera's time goes on (not of neuromorphic-drivers, which hands over what
comes, and the MIPI variant); and that a setting which was written is read back.
libcaer, which no registry has, is used where pkg-config finds it, by libcaer_client.c. comparison.py says what is
printed.
"""

import json
import pathlib
import subprocess
import sys
import time

import comparison
from comparison import check, events, np, package

# A host discards what comes before its own start: events begin after this time.
DELAY_MS = 1500
# Events come for as long, and none for as long, in the middle and at the end.
BUSY_US, QUIET_US = 400_000, 700_000
EVENTS = 20_000

DV = {
    "davis346": (346, 260),
    "davis240": (240, 180),
    "dvxplorer": (640, 480),
    "dvxplorer-mipi": (640, 480),
    "dvs128": (128, 128),
}
ND = {
    "davis346": (346, 260),
    "dvxplorer": (640, 480),
    "evk4": (1280, 720),
    "evk3-hd": (1280, 720),
}


def scene(size):
    """Events of ascending times, with a silence in the middle, some at multiples of the counters' periods."""
    random = np.random.default_rng(7)
    half = EVENTS // 2
    t = np.sort(random.integers(0, BUSY_US, EVENTS))
    t[half:] += BUSY_US + QUIET_US - t[half]
    # The MIPI variant's references of time count milliseconds from 1, and a frame is later than the first of them.
    t += 2500 - t[0]
    for period in (1 << 14, 1 << 15):
        near = np.abs(t % period) < 20
        t[near] -= t[near] % period
    t = np.sort(t)
    array = events(t, random.integers(0, size[0], EVENTS), random.integers(0, size[1], EVENTS), np.zeros(EVENTS))
    array["p"] = random.integers(0, 2, EVENTS)
    # A pixel has one event at a time, and cameras that send rows or frames have an order of their own.
    array = np.unique(array)
    _, first = np.unique(array[["t", "x", "y"]], return_index=True)
    return array[np.sort(first)]


def relative(array):
    array = np.sort(array, order=["t", "x", "y", "p"])
    array["t"] -= array["t"][0] if len(array) else 0
    return array


class Arrivals:
    """How long no event comes after the first `count`: 0 if none comes between those and others."""

    def __init__(self, count):
        self.count, self.came, self.at, self.silence_s = count, 0, None, 0.0

    def add(self, events):
        before, self.came = self.came, self.came + events
        if self.came == self.count:
            self.at = time.monotonic()
        elif before == self.count and self.at is not None:
            self.silence_s = time.monotonic() - self.at


def client_dv(model, seconds, count):
    import dv_processing as dv

    camera = dv.io.camera.open()
    result = {"name": camera.getCameraName(), "size": list(camera.getEventResolution())}
    parts, arrivals = [], Arrivals(count)
    end = time.monotonic() + seconds
    while time.monotonic() < end and camera.isRunning():
        batch = camera.getNextEventBatch()
        if batch is not None and len(batch) > 0:
            parts.append(batch.numpy())
            arrivals.add(len(batch))
        else:
            time.sleep(0.002)
    result["running"] = camera.isRunning()
    result["silence_s"] = arrivals.silence_s
    if model.startswith("dvxplorer"):
        camera.setContrastThresholdOn(7)
        result["setting"] = [7, camera.getContrastThresholdOn()]
    elif model == "dvs128":
        bias = dv.io.camera.DVS128.Bias.DIFF_ON
        camera.setBias(bias, 210000)
        result["setting"] = [210000, camera.getBias(bias)]
    elif model == "davis346":
        bias = dv.io.camera.DAVIS.Davis346BiasCF.On
        camera.setDavis346BiasCoarseFine(bias, 5, 100)
        result["setting"] = [[5, 100], [int(v) for v in camera.getDavis346BiasCoarseFine(bias)[:2]]]
    array = np.concatenate(parts) if parts else np.empty(0, comparison.DTYPE)
    if parts:
        array = events(array["timestamp"], array["x"], array["y"], array["polarity"])
    return result, array


def client_nd(model, seconds, _):
    import neuromorphic_drivers as nd

    parts, result = [], {}
    with nd.open(iterator_timeout=0.1) as device:
        result["name"] = device.properties().name if hasattr(device.properties(), "name") else model
        end = time.monotonic() + seconds
        for _, packet in device:
            if packet is not None and packet.polarity_events is not None and len(packet.polarity_events) > 0:
                parts.append(packet.polarity_events.copy())
            if time.monotonic() >= end:
                break
    array = np.concatenate(parts) if parts else np.empty(0, comparison.DTYPE)
    if parts:
        array = events(array["t"], array["x"], array["y"], array["on"])
    return result, array


def client(driver, model, seconds, out, count):
    result, array = {"dv": client_dv, "nd": client_nd}[driver](model, float(seconds), int(count))
    np.save(out, array)
    print(json.dumps(result))


def libcaer_program(folder):
    """libcaer_client.c, compiled; `None` where there is no libcaer."""
    try:
        flags = subprocess.run(["pkg-config", "--cflags", "--libs", "libcaer"], capture_output=True, text=True)
    except OSError:
        return None
    if flags.returncode != 0:
        print("absent: libcaer")
        return None
    out = folder / "libcaer_client"
    source = pathlib.Path(__file__).with_name("libcaer_client.c")
    subprocess.run(["cc", "-O1", "-o", out, source, *flags.stdout.split()], check=True)
    return out


def camera(folder, driver, model, size, program=None):
    wanted = scene(size)
    source = folder / f"{model}.npz"
    p = wanted["p"].astype(np.uint8)
    np.savez(source, x=wanted["x"], y=wanted["y"], t=wanted["t"].astype(np.int64), p=p)
    out = folder / f"{driver}-{model}.npy"
    count = int(np.searchsorted(wanted["t"], wanted["t"][0] + BUSY_US + QUIET_US // 2))
    seconds = DELAY_MS / 1000 + (2 * BUSY_US + 2 * QUIET_US) / 1e6 + 1.0
    command = [comparison.eecvs, "simulate", model, source, "--width", size[0], "--height", size[1]]
    client = [program, model] if program else [sys.executable, __file__, "--client", driver, model]
    command += ["--delay-ms", DELAY_MS, "--run", *client, seconds, out, count]
    try:
        run = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired as late:
        run = subprocess.CompletedProcess(command, 124, str(late.stdout), str(late.stderr))
    name = f"{driver} {model}"
    if run.returncode != 0 or not out.exists():
        comparison.failures += 1
        print(f"differs  {name}: exit status {run.returncode}\n{run.stdout}\n{run.stderr}")
        return
    result = json.loads(run.stdout.splitlines()[-1])
    if program:
        raw = np.fromfile(out, [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "<u2"), ("zero", "<u2")])
        array = events(raw["t"], raw["x"], raw["y"], raw["p"])
    else:
        array = np.load(out)
    array, wanted = relative(array), relative(wanted)
    if model == "dvxplorer-mipi":
        # Drivers hand over the last 10 ms with the next frame, and a silence has references of time, but no frame.
        end = int(wanted["t"][-1]) - 10_000
        array, wanted = (part[part["t"] < end] for part in (array, wanted))
    elif driver != "nd":
        silence_s = result["silence_s"]
        comparison.verdict(f"{name}: what was before the silence came in it, {silence_s:.1f} s before the rest", silence_s > 0.3)
    check(f"{name} ({result['name']})", array, wanted)
    if "size" in result:
        comparison.verdict(f"{name}: its size", tuple(result["size"]) == size)
    if "setting" in result:
        written, read = result["setting"]
        comparison.verdict(f"{name}: a setting read back as {read}", written == read)
    if "resets" in result and model in ("davis346", "davis240", "dvs128"):
        comparison.verdict(f"{name}: {result['resets']} reset reported", result["resets"] == 1)
    if driver == "dv":
        comparison.verdict(f"{name}: runs to the end", result["running"])


def made(folder):
    program = libcaer_program(folder)
    drivers = [("dv_processing", "dv", DV), ("neuromorphic_drivers", "nd", ND)]
    drivers = [(driver, models) for name, driver, models in drivers if package(name) is not None]
    if program is None and not drivers:
        sys.exit(77)
    for model, size in DV.items() if program else ():
        camera(folder, "libcaer", model, size, program)
    for driver, models in drivers:
        for model, size in models.items():
            camera(folder, driver, model, size)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--client"]:
        client(*sys.argv[2:])
    else:
        comparison.run(__doc__, None, made)
