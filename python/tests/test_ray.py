"""The example of Ray on a cluster of two nodes of this machine."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import SENSOR, random_events

import eecvs

cluster_utils = pytest.importorskip("ray.cluster_utils")
EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "ray_folder.py"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    # Less memory than Ray would take of a large machine.
    node = {"num_cpus": 1, "object_store_memory": 100 << 20}
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    cluster.add_node(**node)
    yield str(cluster.address)
    cluster.shutdown()


def run(*arguments: Any) -> tuple[int, list[str]]:
    ended = subprocess.run(
        [sys.executable, str(EXAMPLE), *map(str, arguments)], capture_output=True, text=True, timeout=200
    )
    assert "Traceback" not in ended.stderr, ended.stderr
    print(ended.stdout, ended.stderr)
    return ended.returncode, ended.stdout.splitlines()


def test_a_folder_is_encoded_and_resumed(address: str, tmp_path: Path) -> None:
    folder, output = tmp_path / "in", tmp_path / "out"
    (folder / "more").mkdir(parents=True)
    names = ["a.raw", "b.dat", "more/c.aedat4", "more/d.npz", "more/e.h5", "f.parquet"]
    for seed, name in enumerate(names):
        eecvs.write(folder / name, random_events(30_000 + seed, seed), sensor=SENSOR)
    (folder / "notes.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    status, lines = run(folder, output, "--address", address, "--coder", "quick")
    assert status == 0 and lines[0] == "7 files, 0 of them done before"
    assert any("notes.png: not a recording" in line for line in lines) and len(lines) == 9
    assert lines[-1] == "encoded on 2 nodes; 0 failed"
    sums = {}
    for seed, name in enumerate(names):
        made = eecvs.open(output / f"{name}.eecvs").info
        assert made.events == 30_000 + seed
        assert made.xxh128_sum_events == eecvs.open(folder / name).info.xxh128_sum_events
        sums[name] = (output / f"{name}.eecvs").stat().st_mtime_ns

    # One was not written, one not checked, one has another source now, one cannot be read, and three were done.
    (output / "a.raw.eecvs").unlink()
    (output / "b.dat.eecvs.json").unlink()
    eecvs.write(folder / "more" / "d.npz", random_events(100), sensor=SENSOR, overwrite=True)
    (folder / "f.parquet").write_bytes((folder / "f.parquet").read_bytes()[:-100])
    status, lines = run(folder, output, "--address", address)
    assert status == 1 and lines[0] == "7 files, 2 of them done before" and lines[-1].endswith("; 1 failed")
    assert sum("f.parquet: " in line and "events," not in line for line in lines) == 1
    assert eecvs.open(output / "a.raw.eecvs").info.events == 30_000
    assert eecvs.open(output / "more" / "d.npz.eecvs").info.events == 100
    assert json.loads((output / "b.dat.eecvs.json").read_text())["events"] == 30_001
    for name in ("more/c.aedat4", "more/e.h5"):
        assert (output / f"{name}.eecvs").stat().st_mtime_ns == sums[name]


def test_nothing_is_to_be_done(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    assert run(tmp_path / "in", tmp_path / "out") == (0, ["0 files, 0 of them done before"])
