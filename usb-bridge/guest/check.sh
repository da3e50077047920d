#!/usr/bin/env bash
# The end-to-end test of simulated devices, in a guest with a real kernel (boot.sh): over usbredir,
# devices of this crate on the host and libusb in the guest; over USB/IP, both in the guest. Needs
# `guest-check`, which `cargo test -p usb-bridge` builds. Exit status 77: something is missing that
# cannot be installed.
set -euo pipefail

here=$(dirname "$0")
check=${CARGO_TARGET_DIR:-$here/../../target}/debug/examples/guest-check
work=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill "$server" 2>/dev/null || true; rm -r "$work"' EXIT

"$check" serve "$work/usb" &
server=$!
for _ in $(seq 100); do
    [ ! -S "$work/usb" ] || break
    sleep 0.1
done
status=0
"$here/boot.sh" -i -s "$work/usb" "$check" all || status=$?
[ "$status" = 0 ] || exit "$status"
# It ends in order when the guest has left.
wait "$server"
server=
