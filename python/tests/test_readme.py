"""Every block of code in the README runs, in its order."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest
from conftest import random_events

import eecvs

README = Path(__file__).resolve().parents[1] / "README.md"


def test_the_blocks_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    events = random_events(60_000)
    events["t"] -= 1_000_000
    eecvs.write("recording.raw", events, sensor=(64, 48))
    blocks = re.findall(r"^```python\n(.*?)^```", README.read_text(), re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 12
    names: dict[str, Any] = {}
    skipped = []
    for block in blocks:
        needs = re.match(r"# needs (\w+)\n", block)
        if needs and importlib.util.find_spec(needs[1]) is None:
            skipped.append(needs[1])
            continue
        exec(compile(block, str(README), "exec"), names)
    with capsys.disabled():
        for name in skipped:
            print(f"\nskipped: a block of README.md: there is no {name}")
