"""Tables of measurements, printed or put into a document between two marks."""

from __future__ import annotations

import platform
from pathlib import Path


def cpu() -> str:
    """Returns the processor's name, if the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(": ", 1)[1] for line in lines if line.startswith("model name")), platform.machine())


def put(name: str, lines: list[str], save: str | None) -> None:
    """Prints a table, and puts it into the document `save` between its marks.

    Raises:
        SystemExit: The document does not have the marks.
    """
    print("\n".join(lines))
    if save is None:
        return
    begin, end = f"<!-- {name}: python python/bench/{name}.py --save docs/python.md -->", f"<!-- {name} end -->"
    path = Path(save)
    text = path.read_text()
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise SystemExit(f"{save}: it does not have the lines {begin!r} and {end!r} once each")
    before, rest = text.split(begin)
    after = rest.split(end)[1]
    path.write_text("\n".join([before + begin, *lines, end]) + after)
