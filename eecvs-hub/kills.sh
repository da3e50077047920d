#!/usr/bin/env bash
# A hub that is killed again and again under load: kills.sh [SECONDS]
#
# 8 sensors send 1.5 million events a second each to a hub, 3 receivers take all, as in load.sh, for 240 s by default;
# the hub is killed (SIGKILL) every 2.5 s and started again after 0.3 s. Ends with status 1 if a program does not end
# as it should, or a frame is missing. Every link fails with each kill, which finds faults that only one failure in a
# hundred shows.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-240}
cargo build --release --quiet -p eecvs-hub
program=$PWD/${CARGO_TARGET_DIR:-target}/release/eecvs-hub
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait 2>/dev/null || true; rm -rf "$folder"' EXIT
cd "$folder"
export RUST_BACKTRACE=1
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
hub=tls/127.0.0.1:$port
"$program" keys fleet hub main >/dev/null
"$program" keys fleet receiver all --hears '**' >/dev/null
start_hub() {
    "$program" hub --keys fleet/hub-main --listen "$hub" --no-page 2>>hub.log &
    hub_process=$!
}
start_hub
sleep 1
programs=()
for receiver in 1 2 3; do
    "$program" receive --keys fleet/receiver-all --connect "$hub" --json --idle-s 25 >"received-$receiver" 2>"receiver-$receiver.log" &
    programs+=($!)
done
for sensor in {1..8}; do
    "$program" keys fleet sensor "$sensor" >/dev/null
    "$program" sensor "$sensor" --keys "fleet/sensor-$sensor" --connect "$hub" --scene outdoor-well-lit-blur \
        --seed "$sensor" --rate 1500000 --repeat --seconds "$seconds" --store "store-$sensor" --store-mib 4096 \
        --linger-s 120 --json >"sent-$sensor" 2>"sensor-$sensor.log" &
    programs+=($!)
done
kills=0 failed=0
until=$((SECONDS + seconds - 8))
while [ "$SECONDS" -lt "$until" ]; do
    sleep 2.5
    kill -KILL "$hub_process" || failed=$((failed + 1))
    wait "$hub_process" 2>/dev/null || true
    kills=$((kills + 1))
    sleep 0.3
    start_hub
done
for process in "${programs[@]}"; do
    wait "$process" || failed=$((failed + 1))
done
echo "the hub was killed $kills times"
[ "$failed" = 0 ] || { cat ./*.log >&2; echo "kills.sh: $failed programs did not end as they should" >&2; exit 1; }
python3 - <<'PYTHON'
import glob
import json
import sys

sent = {one["name"]: one["frames"] for one in (json.load(open(name)) for name in glob.glob("sent-*"))}
whole = True
for name in sorted(glob.glob("received-*")):
    received = json.load(open(name))
    frames = {sensor["name"]: sensor["frames"] for sensor in received["sensors"]}
    again = sum(sensor["again"] for sensor in received["sensors"])
    print(f"{name}: {sum(frames.values())} of {sum(sent.values())} frames, {again} asked for again")
    whole = whole and frames == sent
sys.exit(not whole)
PYTHON
