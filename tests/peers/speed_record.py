"""Records of measured speeds, for the scripts that measure them."""

import datetime
import importlib.metadata
import json
import pathlib
import platform
import subprocess
import sys


def processor():
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.machine()


def write(path, eecvs, rows, threads):
    """A record as host-harness/src/record_file.rs reads it, a row a line; `threads` says how many were used."""
    for row in rows:
        if row["library"] != "eecvs":
            row["version"] = importlib.metadata.version(row["library"])
    version = subprocess.run([eecvs, "--version"], check=True, capture_output=True, text=True).stdout
    head = {
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "machine": f"{processor()}, {threads}, {sys.platform}",
        "version": version.split()[1],
    }
    lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in rows)
    head = json.dumps(head, separators=(",", ":"))
    path.write_text(f'{head[:-1]},"rows":[\n{lines}\n]}}\n')
