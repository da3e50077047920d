#!/usr/bin/env bash
# Sensors at full load through one hub: load.sh [SECONDS] [--kill] [--json], or load.sh --record FILE
#
# 8 sensors send the events of a scene at 2 million a second each, in mode hybrid, to a hub, and 3 receivers take all of
# them: each a program of its own on this computer, over encrypted links. With --kill the hub is killed (SIGKILL)
# halfway, and started again after 5 s; sensors keep frames on disk meanwhile. Prints what was sent and received, and
# ends with status 1 if a frame is missing, or if sensors or receivers report that they lost one.
#
# SENSORS, RATE, RECEIVERS and WINDOW_US of the environment replace these numbers.
#
# With --record, it does so without and with --kill, has eecvs-hub simulate its 1,000 sensors, and writes the record
# from which the table of docs/hub.md is made. Run that on a machine that does nothing else.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=20 kill='' json='' record=''
while [ $# -gt 0 ]; do
    case $1 in
        --kill) kill=1 ;;
        --json) json=1 ;;
        --record) record=$(realpath -m "${2:?--record wants a file}"); shift ;;
        *[!0-9]* | '') sed -n '2,12s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
        *) seconds=$1 ;;
    esac
    shift
done
sensors=${SENSORS:-8} rate=${RATE:-2000000} receivers=${RECEIVERS:-3} window_us=${WINDOW_US:-32768}
cargo build --release --quiet -p eecvs-hub
program=$PWD/${CARGO_TARGET_DIR:-target}/release/eecvs-hub
if [ -n "$record" ]; then
    model=$(sed -n 's/^model name[^:]*: *//p' /proc/cpuinfo | head -1)
    rows=()
    for run in 20 "30 --kill"; do
        # shellcheck disable=SC2086
        rows+=("{\"load\":$(eecvs-hub/load.sh $run --json)}")
    done
    rows+=("{\"simulation\":$("$program" simulate --json)}")
    {
        echo "{\"date\":\"$(date -u +%F)\",\"machine\":\"${model:-$(uname -m)}, $(nproc) threads, linux\",\"version\":\"$("$program" --version | cut -d ' ' -f 2)\",\"rows\":["
        printf '%s\n' "${rows[@]}" | sed '$!s/$/,/'
        echo "]}"
    } >"$record"
    exit
fi
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait 2>/dev/null || true; rm -rf "$folder"' EXIT
cd "$folder"
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
hub=tls/127.0.0.1:$port
"$program" keys fleet hub main >/dev/null
"$program" keys fleet receiver all --hears '**' >/dev/null
for sensor in $(seq "$sensors"); do
    "$program" keys fleet sensor "$sensor" >/dev/null
done
start_hub() {
    "$program" hub --keys fleet/hub-main --listen "$hub" --no-page 2>>hub.log &
    hub_process=$!
}
start_hub
sleep 1
takes=()
for receiver in $(seq "$receivers"); do
    "$program" receive --keys fleet/receiver-all --connect "$hub" --json --idle-s 15 >"received-$receiver" 2>"receiver-$receiver.log" &
    takes+=($!)
done
sleep 1
sends=()
for sensor in $(seq "$sensors"); do
    "$program" sensor "$sensor" --keys "fleet/sensor-$sensor" --connect "$hub" --scene outdoor-well-lit-blur \
        --seed "$sensor" --rate "$rate" --repeat --seconds "$seconds" --window-us "$window_us" --store "store-$sensor" \
        --linger-s 120 --json >"sent-$sensor" 2>"sensor-$sensor.log" &
    sends+=($!)
done
if [ -n "$kill" ]; then
    sleep "$((seconds / 2))"
    kill -KILL "$hub_process"
    wait "$hub_process" 2>/dev/null || true
    sleep 5
    start_hub
fi
for process in "${sends[@]}" "${takes[@]}"; do
    wait "$process" || { cat ./*.log >&2; echo "load.sh: a program failed" >&2; exit 1; }
done
cat ./hub.log ./receiver-*.log >&2
python3 - "$json" "$kill" sent-* -- received-* <<'PYTHON'
import json
import sys

as_json, killed, files = sys.argv[1], sys.argv[2], sys.argv[3:]
at = files.index("--")
sent = [json.load(open(name)) for name in files[:at]]
received = [json.load(open(name)) for name in files[at + 1 :]]
frames = {sensor["name"]: sensor["frames"] for sensor in sent}
wall_s = max(sensor["wall_s"] for sensor in sent)
row = {
    "killed": killed != "",
    "sensors": len(sent),
    "receivers": len(received),
    "seconds": round(wall_s, 2),
    "events": sum(sensor["events_in"] for sensor in sent),
    "frames": sum(frames.values()),
    "bytes": sum(sensor["bytes_out"] for sensor in sent),
    "outages": sum(sensor["outages"] for sensor in sent),
    "frames_on_disk": sum(sensor["frames_on_disk"] for sensor in sent),
    "frames_let_go": sum(sensor["frames_let_go"] for sensor in sent),
    "frames_again": sum(sensor["again"] for one in received for sensor in one["sensors"]),
    "frames_lost": sum(sensor["lost"] for one in received for sensor in one["sensors"]),
    "frames_received": sum(sensor["frames"] for one in received for sensor in one["sensors"]),
    "delay_p50_ms": max(sensor["delay_p50_ms"] for one in received for sensor in one["sensors"]),
    "delay_p99_ms": max(sensor["delay_p99_ms"] for one in received for sensor in one["sensors"]),
}
row["events_per_s"] = round(row["events"] / wall_s)
row["bytes_per_s"] = round(row["bytes"] / wall_s)
whole = all({s["name"]: s["frames"] for s in one["sensors"]} == frames for one in received)
whole = whole and row["frames_lost"] == row["frames_let_go"] == 0
exact = all(s["events_thinned"] == s["events_dropped"] == s["events_approximate"] == 0 for s in sent)
row["events_exact"] = exact
if as_json:
    print(json.dumps(row))
else:
    for key, value in row.items():
        print(f"{key:<18} {value}")
if not whole:
    print("load.sh: not every frame was received", file=sys.stderr)
    sys.exit(1)
PYTHON
