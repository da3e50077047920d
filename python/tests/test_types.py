"""The stubs against the module, and the tests themselves by the checkers of types."""

from __future__ import annotations

import importlib.util
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import eecvs

FOLDER = Path(__file__).resolve().parent


def run(*arguments: str) -> None:
    name = arguments[0].split(".")[0]
    if importlib.util.find_spec(name) is None:
        pytest.skip(f"there is no {name}")
    ended = subprocess.run(
        [sys.executable, "-m", *arguments], cwd=FOLDER, capture_output=True, text=True, timeout=500
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_stubs_are_those_of_the_module() -> None:
    run("mypy.stubtest", "eecvs", "--ignore-missing-stub", "--allowlist", str(FOLDER / "stubtest.txt"))


def test_mypy() -> None:
    run("mypy", "--strict", str(FOLDER / "typed.py"))


def test_pyright() -> None:
    run("pyright", "--pythonpath", sys.executable, str(FOLDER / "typed.py"))


def documented() -> list[tuple[str, Any]]:
    found = []
    for name in eecvs.__all__:
        thing = getattr(eecvs, name)
        if name.isupper():
            continue
        found.append((name, thing))
        if inspect.isclass(thing) and thing.__module__ == "eecvs":
            found += [(f"{name}.{key}", value) for key, value in vars(thing).items() if not key.startswith("_")]
    return found


@pytest.mark.parametrize(("name", "thing"), documented(), ids=lambda value: value if isinstance(value, str) else "")
def test_everything_is_documented(name: str, thing: Any) -> None:
    assert thing.__doc__ and thing.__doc__.strip().endswith(tuple(".:")), name
    if callable(thing) and not inspect.isclass(thing) and inspect.signature(thing).parameters.keys() - {"self"}:
        assert len(thing.__doc__) > 40


def test_every_option_of_the_encoder_is_typed() -> None:
    """The keywords in options.rs are those of EncodeOptions."""
    source = FOLDER.parent / "src" / "options.rs"
    if not source.exists():
        pytest.skip(f"there is no {source}")
    names = set(re.findall(r'^    \("(\w+)", \|', source.read_text(), re.MULTILINE))
    assert names == set(eecvs.EncodeOptions.__annotations__)
