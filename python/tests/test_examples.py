"""The notebooks of examples/ run, cell by cell, and the ten lines of docs/python.md."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
from pathlib import Path
from typing import Any

import pytest

import eecvs

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "python" / "examples").glob("*.ipynb"))


def value_of(source: str, names: dict[str, Any]) -> Any:
    """Runs a cell and returns the value of its last line, which a notebook shows."""
    body = ast.parse(source).body
    last = body.pop() if isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, []), "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names) if last else None  # type: ignore[attr-defined]


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    shown = []
    for cell in json.loads(path.read_text())["cells"]:
        assert not cell.get("outputs"), "it is kept without outputs"
        if cell["cell_type"] == "code":
            shown.append(value_of("".join(cell["source"]), names))
    assert any(hasattr(value, "_repr_png_") for value in shown)
    rows = names["rows"]
    # Exact, then ever fewer bits at an error within the tolerance.
    assert rows[0][1] == 0 and rows[0][0] > rows[16][0] > rows[256][0]
    assert all(error_us <= tolerance_us for tolerance_us, (_, error_us) in rows.items())


def block_of(path: Path) -> str:
    block, *_ = re.findall(r"^```python\n(.*?)^```", path.read_text(), re.DOTALL | re.MULTILINE)
    return str(block)


def test_ten_lines_to_a_training_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    block = block_of(ROOT / "docs" / "python.md")
    assert block == block_of(ROOT / "README.md")
    if importlib.util.find_spec("torch") is None:
        pytest.skip("there is no torch")
    monkeypatch.chdir(tmp_path)
    eecvs.write("recording.raw", eecvs.emulate("motorcycle", sensor=(32, 24), duration_us=100_000))
    exec(compile(block, "docs/python.md", "exec"), {})
