"""Encodes a folder of recordings over the workers of a Ray cluster, and checks each of them: every event comes back.

    python python/examples/ray_folder.py RECORDINGS OUTPUT [--coder quick] [--address HOST:PORT]

Without an address it runs on this machine's cores. All nodes need this package, and both folders under the same paths.

`RECORDINGS/a/b.raw` becomes `OUTPUT/a/b.raw.eecvs`, which gets its name when it is complete, and `b.raw.eecvs.json`, which
says that it was checked. What was checked is left as it is when the command runs again, unless its source has changed: an
interrupted run goes on where it was. The exit status is 1 if a recording failed.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import ray

import eecvs


def sources(folder: Path) -> list[Path]:
    """Returns the files that may be recordings, the largest first: these would else be waited for at the end."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.suffix not in (".eecvs", ".json", ".md")]
    return sorted(files, key=lambda path: (-path.stat().st_size, path))


def stamp(source: Path) -> dict[str, int]:
    """Returns what says that a source is still the one that was encoded."""
    file = source.stat()
    return {"source_bytes": file.st_size, "source_modified_ns": file.st_mtime_ns}


def is_done(source: Path, target: Path) -> bool:
    try:
        noted = json.loads(Path(f"{target}.json").read_text())
        return all(noted.get(key) == value for key, value in {**stamp(source), "bytes": target.stat().st_size}.items())
    except (OSError, ValueError):
        return False


def encode(source: Path, target: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Encodes a recording, reads it back, and notes that its events are those of the source."""
    noted: dict[str, Any] = {**stamp(source), "node": ray.get_runtime_context().get_node_id()}
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        with eecvs.open(source) as recording:
            # Ray has one task for each core.
            eecvs.write(target, recording, overwrite=True, threads=1, **options)
            wanted, found = recording.info, eecvs.open(target).info
    except eecvs.UnsupportedError:
        return {"left_out": "not a recording"}
    except eecvs.EecvsError as error:
        return {"failed": str(error)}
    if (wanted.events, wanted.xxh128_sum_events) != (found.events, found.xxh128_sum_events):
        target.unlink()
        return {"failed": f"{found.events} of {wanted.events} events came back, or others"}
    noted |= {"events": wanted.events, "sum": wanted.xxh128_sum_events, "bytes": target.stat().st_size}
    part = Path(f"{target}.json.part")
    part.write_text(json.dumps(noted))
    os.replace(part, f"{target}.json")
    return noted


def encoded(jobs: list[tuple[Path, Path]], options: dict[str, Any]) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Encodes by all workers; gives each source and what came of it, in the order in which they end."""
    remote = ray.remote(num_cpus=1, max_retries=2)(encode)
    waiting = list(reversed(jobs))
    running: dict[Any, Path] = {}
    most = 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
    while waiting or running:
        while waiting and len(running) < most:
            source, target = waiting.pop()
            running[remote.remote(source, target, options)] = source
        ended, _ = ray.wait(list(running), num_returns=1)
        for reference in ended:
            source = running.pop(reference)
            try:
                yield source, ray.get(reference)
            except ray.exceptions.RayError as error:
                yield source, {"failed": f"a worker ended: {error}".splitlines()[0]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--coder", choices=["fast", "quick", "dense"], help="the codec's coder")
    parser.add_argument("--address", help="the cluster's head; by default one of this machine alone")
    arguments = parser.parse_args()
    folder, output = arguments.recordings.resolve(), arguments.output.resolve()
    if not folder.is_dir():
        parser.error(f"{folder} is no folder")
    files = [(path, output / f"{path.relative_to(folder)}.eecvs") for path in sources(folder) if output not in path.parents]
    jobs = [(source, target) for source, target in files if not is_done(source, target)]
    print(f"{len(files)} files, {len(files) - len(jobs)} of them done before")
    if not jobs:
        return 0
    ray.init(address=arguments.address, log_to_driver=False, logging_level=logging.ERROR)
    failed, nodes = 0, set()
    for count, (source, noted) in enumerate(encoded(jobs, {"coder": arguments.coder}), 1):
        name = f"{count}/{len(jobs)} {source.relative_to(folder)}"
        if "bytes" in noted:
            nodes.add(noted["node"])
            bits = 8 * noted["bytes"] / max(1, noted["events"])
            print(f"{name}: {noted['events']} events, {bits:.1f} bits each", flush=True)
        else:
            failed += "failed" in noted
            print(f"{name}: {noted.get('failed') or noted['left_out']}", flush=True)
    print(f"encoded on {len(nodes)} nodes; {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
