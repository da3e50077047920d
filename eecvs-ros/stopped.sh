#!/usr/bin/env bash
# Memory and losses of nodes beside a subscriber that is stopped (SIGSTOP), as if its computer hung:
# stopped.sh [dds|zenoh] [SECONDS]
#
# Runs emulate, encode and decode in a domain of their own, stops decode after 10 s, and prints the resident memory of
# emulate and encode every tenth of the time, and what they say at their end. Ends with status 1 if either has grown
# by more than 8 MB from a fifth of the time to the end, or a message from emulate to encode was lost.
set -euo pipefail
cd "$(dirname "$0")/.."
transport=${1:-dds} seconds=${2:-600}
cargo build --release --quiet -p eecvs-ros
program=target/release/eecvs-ros
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-91} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
run=("$program" --transport "$transport")
said=$(mktemp)
trap 'kill -CONT $(jobs -p) 2>/dev/null; kill $(jobs -p) 2>/dev/null; wait 2>/dev/null; rm -f "$said"' EXIT
if [ "$transport" = zenoh ]; then
    run+=(--connect tcp/127.0.0.1:7491)
    "$program" router --listen tcp/127.0.0.1:7491 &
    sleep 1
fi
"${run[@]}" decode & decode=$!
"${run[@]}" encode --allow-loss --window-us 4000 2>"$said" & encode=$!
sleep 2
"${run[@]}" emulate --repeat --wait-s 10 & emulate=$!
memory() { awk '/^VmRSS/ { print $2 }' "/proc/$1/status"; }
sleep 10
kill -STOP "$decode"
for tenth in {1..10}; do
    sleep "$(awk "BEGIN { print $seconds / 10 }")"
    now=("$(memory "$emulate")" "$(memory "$encode")")
    echo "$(awk "BEGIN { print $tenth * $seconds / 10 }") s: emulate ${now[0]} kB, encode ${now[1]} kB"
    [ "$tenth" != 2 ] || then=("${now[@]}")
done
for node in 0 1; do
    [ $((now[node] - then[node])) -le 8192 ] || { echo "memory has grown"; exit 1; }
done
kill -TERM "$emulate"
wait "$emulate"
# What is on its way arrives.
sleep 1
kill -TERM "$encode"
wait "$encode"
cat "$said"
grep -q " messages (0 lost, " "$said" || { echo "messages were lost"; exit 1; }
