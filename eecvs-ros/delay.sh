#!/usr/bin/env bash
# How long after their windows' end frames arrive, and what is lost: delay.sh [--record FILE] [--seconds N] [--window-us T]
#
# Plays a recording of 5.45 million events per second at its own speed, again and again: emulate, encode with its
# default coder, and delay, which takes the frames, each a process of its own, for N seconds (20 by default) with
# every transport and every window (4000, 8000 and 32768 us by default):
#
#   dds    over the loopback
#   zenoh  by two routers in a chain: emulate and delay are at the first one, encode at the second, so that events as
#          well as frames pass both
#
#   --record FILE  also writes the rows as a record, from which a document's table is made
#
# Run it on a machine that does nothing else.
set -euo pipefail
cd "$(dirname "$0")/.."

record='' seconds=20 windows=(4000 8000 32768)
while [ $# -gt 0 ]; do
    case $1 in
        --record) record=$(realpath -m "${2:?--record wants a file}"); shift 2 ;;
        --seconds) seconds=${2:?--seconds wants a number}; shift 2 ;;
        --window-us) windows=("${2:?--window-us wants microseconds}"); shift 2 ;;
        *) sed -n '2,14s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
    esac
done
recording=../shared/data/gen3_vga_dense_evt2/evt2.raw
[ -e "$recording" ] || { echo "eecvs-ros/delay.sh: $recording is missing: put the shared recordings beside the project" >&2; exit 1; }
cargo build --release --quiet -p eecvs-ros
program=${CARGO_TARGET_DIR:-target}/release/eecvs-ros
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-92} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
first=tcp/127.0.0.1:7492 second=tcp/127.0.0.1:7493
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null; wait 2>/dev/null; rm -rf "$work"' EXIT

# Messages of events that encode says it has lost: `lost FILE`
lost() {
    local said
    said=$(sed -n 's/.* events of [0-9]* messages (\([0-9]*\) lost, .*/\1/p' "$1")
    [ -n "$said" ] || { echo "eecvs-ros/delay.sh: encode did not report what it lost:" >&2; cat "$1" >&2; exit 1; }
    echo "$said"
}

# measure TRANSPORT WINDOW_US: a row
measure() {
    local here=(--transport "$1") there=(--transport "$1") routers=() measured
    if [ "$1" = zenoh ]; then
        here+=(--connect "$first") there+=(--connect "$second")
        "$program" router --listen "$first" 2>/dev/null & routers+=($!)
        "$program" router --listen "$second" --connect "$first" 2>/dev/null & routers+=($!)
        sleep 2
    fi
    "$program" "${there[@]}" encode --allow-loss --window-us "$2" 2>"$work/encode" & local encode=$!
    # Whoever has just been found may miss the first frames.
    "$program" "${here[@]}" delay --allow-loss --seconds "$seconds" --skip 50 --json >"$work/delay" & local delay=$!
    sleep 3
    "$program" "${here[@]}" emulate --recording "$recording" --repeat --wait-s 20 2>"$work/emulate" & local emulate=$!
    wait "$delay"
    kill -TERM "$emulate"
    wait "$emulate"
    kill -TERM "$encode"
    wait "$encode"
    [ ${#routers[@]} = 0 ] || { kill -TERM "${routers[@]}"; wait "${routers[@]}"; }
    measured=$(cat "$work/delay")
    echo "{\"transport\":\"$1\",\"window_us\":$2,\"packets_lost\":$(lost "$work/encode"),${measured#\{}"
}

rows=()
for transport in dds zenoh; do
    for window_us in "${windows[@]}"; do
        measure "$transport" "$window_us" >"$work/row"
        cat "$work/row"
        rows+=("$(cat "$work/row")")
    done
done
if [ -n "$record" ]; then
    model=$(sed -n 's/^model name[^:]*: *//p' /proc/cpuinfo | head -1)
    version=$("$program" --version | cut -d ' ' -f 2)
    {
        echo "{\"date\":\"$(date -u +%F)\",\"machine\":\"${model:-$(uname -m)}, $(nproc) threads, linux\",\"version\":\"$version\",\"rows\":["
        printf '%s\n' "${rows[@]}" | sed '$!s/$/,/'
        echo "]}"
    } >"$record"
fi
