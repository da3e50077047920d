#!/usr/bin/env bash
# Counts the instructions of every stage on a Cortex-M4 in QEMU: firmware/instructions.sh [--save|--check]
#
#            prints the table; the counts are in firmware/target/instructions.json. And, from another
#            image, what the whole takes in plain Rust, without the core's assembly
#   --save   also takes them over into firmware/instructions.json, which is committed, and from there
#            into the README's tables
#   --check  compares with those and fails where a stage has grown by over 3 %
#
# The windows are cut from the recordings in ../shared/data, where they are there, and always from
# emulated scenes. Figures of the two are kept and compared apart.
set -euo pipefail
cd "$(dirname "$0")"

action=${1:-}
case $action in
    '' | --save | --check) ;;
    *) sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
esac

tool() { cargo run --quiet --release --locked --manifest-path ../Cargo.toml -p eecvs-tests --bin instructions -- "$@"; }

if ! command -v qemu-system-arm >/dev/null; then
    echo "firmware/instructions.sh: qemu-system-arm is missing: apt-get install qemu-system-arm" >&2
    exit 1
fi
./cuts.sh
folder=$(./build.sh netduinoplus2 instructions | tail -n 1)
counts=target/instructions.json
run() {
    timeout 300 qemu-system-arm -M netduinoplus2 -display none -monitor none -serial null \
        -icount shift=0 -semihosting-config enable=on,target=native \
        -kernel "$folder/instructions" </dev/null >"$1" || {
        echo "firmware/instructions.sh: the image failed:" >&2
        tail -n 5 "$1" >&2
        exit 1
    }
}
run "$counts"
tool verify "$counts" target/cuts
tool table "$counts"
case $action in
    --save)
        tool save "$counts" instructions.json
        tool readme instructions.json ../README.md
        ;;
    --check) tool check "$counts" instructions.json ;;
    *)
        ./build.sh netduinoplus2 instructions portable >/dev/null
        run target/instructions-portable.json
        tool portable "$counts" target/instructions-portable.json
        ;;
esac
