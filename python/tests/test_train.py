"""The example that trains a network: its masks and inputs, its record and tables, and a quick run."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import xml.etree.ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eecvs

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "train"
RECORD = EXAMPLE / "record" / "record.json"


@pytest.fixture(autouse=True)
def example(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLE))


def test_what_moves_by_itself() -> None:
    from clips import moving

    def of(name: str, t_us: int) -> tuple[Any, Any]:
        truth = eecvs.emulate(name, sensor=(120, 90), duration_us=600_000).truth(t_us)
        return truth, moving(truth)

    # The box, and not the lamp.
    truth, mask = of("motorcycle", 60_000)
    assert np.array_equal(mask, truth.object == 1) and (truth.object == 2).any()
    # A person, and a bar that turns about a point that stays.
    truth, mask = of("indoor-dark-hdr", 100_000)
    assert {truth.objects[number] for number in np.unique(truth.object[mask])} == {"box"}
    assert np.array_equal(mask, (truth.object == 1) | (truth.object == 2))
    # Nothing but the camera moves.
    assert not of("indoor-dark-blur", 100_000)[1].any() and not of("indoor-hdr-blur", 500_000)[1].any()


def test_arrays_of_coded_events() -> None:
    import clips
    import inputs

    clip = clips.of_scene("motorcycle", 1, (48, 36), 2)
    for name in (*inputs.TRANSFORMS, *inputs.ARRAYS):
        exact, none = inputs.arrays(name, 8, clip)
        assert none == 0 and len(exact) == clip.count
        fine, coarse = ("2^-10", "2^3") if name in inputs.TRANSFORMS else ("lossless", "2048 us")
        again, most = inputs.arrays(name, 8, clip, fine)
        _, least = inputs.arrays(name, 8, clip, coarse)
        assert 0 < least < most or name == "dwt" and 0 < least <= most
        for one, other in zip(exact, again):
            assert one.kind == other.kind and one.values.shape[1] == inputs.channels(name, 8)[one.kind]
            assert np.array_equal(one.places, other.places)
            # Few events may come as cells of times: within a step.
            assert np.abs(one.values - other.values).max() <= (2**-10 if name in inputs.TRANSFORMS else 0)
    bins, _ = inputs.arrays("bins", 8, clip)
    sent, _ = inputs.arrays("bins", 8, clip, "bins")
    assert all(np.array_equal(one.values, other.values) for one, other in zip(bins, sent))


def test_the_tables_are_those_of_the_record() -> None:
    import chart
    import report

    record = json.loads(RECORD.read_text(encoding="utf-8"))
    text = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    between = text.split(report.BEGIN + "\n")[1].split("\n" + report.END)[0]
    assert between.splitlines() == report.lines(record)
    assert (RECORD.parent / "iou.svg").read_text(encoding="utf-8") == chart.chart(record)
    assert report.text_of(record) == RECORD.read_text(encoding="utf-8")


def test_figures_of_a_record() -> None:
    import report

    def row(setting: Any, bits: Any, iou: list[Any], source: str = "a", of: str = "unseen") -> dict[str, Any]:
        marked = [0.25, 0.75]
        key = {"input": "dct", "m": 16, "setting": setting, "set": of, "source": source}
        return {**key, "bits": bits, "iou": iou, "marked": marked}

    record = {
        "sources": [{"set": "unseen", "source": "a", "moving": 0.1}, {"set": "unseen", "source": "b", "moving": 0}],
        "rows": [
            row(None, None, [0.5, 0.7]),
            row(None, None, [None, None], "b"),
            row("2^-6", 10.0, [0.4, 0.6]),
            row("2^0", 10.0, [0.2, 0.4]),
            row("2^1", 4.0, [0.1, 0.3]),
        ],
    }
    figure = report.iou(record, "dct", 16)
    assert figure is not None and figure.by_seed == (0.5, 0.7)
    assert str(figure) == "0.600 ± 0.141"
    false = report.falsely_marked(record, "dct", 16)
    assert false is not None and false.by_seed == (0.25, 0.75)
    of_bits = {bits: report.at_bits(record, "dct", 16, bits, "unseen") for bits in (3, 4, 7, 10, 20)}
    assert of_bits[3] is None
    means = {bits: round(figure.mean, 9) for bits, figure in of_bits.items() if figure is not None}
    assert means == {4: 0.2, 7: 0.35, 10: 0.5, 20: 0.5}


def test_a_quick_run(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="there is no torch: a network is not trained")
    import inputs

    command = [sys.executable, str(EXAMPLE / "study.py"), "--quick", "-o", str(tmp_path)]
    begin = time.monotonic()
    ended = subprocess.run(command, capture_output=True, text=True, timeout=180)
    print(f"{time.monotonic() - begin:.0f} s")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["iou.svg", "record.json"]
    record = json.loads((tmp_path / "record.json").read_text(encoding="utf-8"))
    assert {row["input"] for row in record["rows"]} == {*inputs.TRANSFORMS, *inputs.ARRAYS}
    for row in record["rows"]:
        assert len(row["iou"]) == 2 and all(iou is None or 0 <= iou <= 1 for iou in row["iou"])
        # Exact events give the masks that events give as they are.
        if row["setting"] in ("lossless", "bins") and row["set"] == "recordings":
            assert all(iou in (None, 1) for iou in row["iou"])
    assert "| DCT |" in ended.stdout
    xml.etree.ElementTree.parse(tmp_path / "iou.svg")
    # What is there is not destroyed.
    again = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert again.returncode == 2 and "--overwrite" in again.stderr
