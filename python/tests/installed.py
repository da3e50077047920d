"""A program for an environment that has the installed package, what it depends on, and nothing else: no Rust, no sources."""

from __future__ import annotations

import importlib.metadata
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

import eecvs
from eecvs.data import Windows


def main() -> None:
    for program in ("cargo", "rustc", "cc"):
        assert shutil.which(program) is None, f"there is {program}"
    assert Path(sys.prefix) in Path(eecvs.__file__).parents, f"{eecvs.__file__} is not the installed package"
    scene = eecvs.emulate("motorcycle", sensor=(32, 24), duration_us=50_000)
    events = scene.read()
    frames = eecvs.encode(events, sensor=scene.sensor)
    assert len(events) and np.array_equal(eecvs.decode(frames), events)
    with tempfile.TemporaryDirectory() as folder:
        for ending in ("eecvs", "raw", "aedat4", "h5", "npz", "parquet"):
            path = Path(folder, f"a.{ending}")
            eecvs.write(path, scene)
            with eecvs.open(path) as recording:
                assert np.array_equal(recording.read(), events), ending
        data = Windows(Path(folder, "a.eecvs"), 10_000)
        assert sum(len(data[i]) for i in range(len(data))) == len(events)
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("eecvs", "numpy")]
    print(f"Python {sys.version.split()[0]}, {', '.join(versions)}: {len(events)} events there and back")


if __name__ == "__main__":
    main()
