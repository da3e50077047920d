#!/usr/bin/env bash
# Counts the instructions of every kernel of the accumulate stage on a Cortex-M4 and a Cortex-M7 in
# QEMU: firmware/kernels.sh [--save|--check]
#
#            prints the table; the counts are in firmware/target/kernels.json
#   --save   also takes them over into firmware/kernels.json, which is committed, and from there
#            into the README's table
#   --check  compares with those and fails where a count has grown by over 3 %, by over 25 % of the
#            kernels that the encoder does not take
#
# The cuts are those of instructions.sh: of the recordings in ../shared/data, where all are there, and
# always of emulated scenes. Counts of the two are kept and compared apart. The sums of every kernel
# are compared with this host's.
set -euo pipefail
cd "$(dirname "$0")/.."

action=${1:-}
case $action in
    '' | --save | --check) ;;
    *) sed -n '2,9s/^# \{0,1\}//p' firmware/kernels.sh >&2; exit 2 ;;
esac

tool() { cargo run --quiet --release --locked -p eecvs-tests --bin kernel_counts -- "$@"; }

counts=firmware/target/kernels.json
mkdir -p firmware/target
tool run "$counts" ../shared/data
case $action in
    --save)
        tool table "$counts"
        tool save "$counts" firmware/kernels.json
        tool readme firmware/kernels.json README.md
        ;;
    --check) tool check "$counts" firmware/kernels.json ;;
    *) tool table "$counts" ;;
esac
