#!/usr/bin/env bash
# The end-to-end test of simulated devices, in a guest with a real kernel (boot.sh):
#
#   over usbredir   test devices on the host, one after the other; libusb in the guest
#   over USB/IP     the same, with both ends in the guest and vhci-hcd between them
#   cameras         `eecvs-usb simulate` of each model on the host; every event comes in the guest
#
# Needs `guest-check` and `eecvs-usb`, which `cargo test -p usb-bridge` builds. Exit status 77:
# something is missing that cannot be installed.
set -euo pipefail

here=$(dirname "$0")
programs=${CARGO_TARGET_DIR:-$here/../../target}/debug
check=$programs/examples/guest-check
work=$(mktemp -d)
started=()
stop() {
    [ ${#started[@]} -eq 0 ] || kill "${started[@]}" 2>/dev/null || true
    rm -r "$work"
}
trap stop EXIT

"$check" serve "$work/sequence" >>"$work/log" 2>&1 &
started+=($!)
sockets=(-s "$work/sequence")
wanted=()
"$check" scenes "$work" >"$work/scenes"
while read -r model file events digest; do
    "$programs/eecvs-usb" simulate "$model" "$file" --rate max \
        --usbredir "$work/$model" --once --json >>"$work/log" 2>&1 &
    started+=($!)
    sockets+=(-s "$work/$model")
    wanted+=("$model" "$events" "$digest")
done <"$work/scenes"
for socket in "${sockets[@]}"; do
    for _ in $(seq 100); do
        [ "$socket" != -s ] && [ ! -S "$socket" ] || break
        sleep 0.1
    done
done

# What the devices' side has to say is of interest where something fails.
fail() { cat "$work/log"; exit "$1"; }
status=0
"$here/boot.sh" -i "${sockets[@]}" "$check" all "${wanted[@]}" || status=$?
[ "$status" = 0 ] || fail "$status"
# Each ends in order when the guest has left.
for process in "${started[@]}"; do
    wait "$process" || fail $?
done
started=()
