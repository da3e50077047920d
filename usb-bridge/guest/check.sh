#!/usr/bin/env bash
# The end-to-end test of simulated devices, in a guest with a real kernel (boot.sh):
#
#   over usbredir   test devices on the host, one after the other; libusb in the guest
#   over USB/IP     the same, with both ends in the guest and vhci-hcd between them
#   the cable       cameras that come late, are pulled and halt; `eecvs-usb` in the guest
#   cameras         `eecvs-usb simulate` of each model on the host, `eecvs-usb capture` in the guest: every
#                   event of a scene, and of a recording of each family where the shared ones are present
#
# Needs `guest-check` and `eecvs-usb`, which `cargo test -p usb-bridge` builds. Exit status 77:
# something is missing that cannot be installed. recordings.sh takes every recording.
set -euo pipefail
. "$(dirname "$0")/offer.sh"

offer sequence "$check" serve SOCKET
"$check" scenes "$work" >"$work/plan"
if [ -e "$data/REFERENCE.json" ]; then
    "$check" recordings "$data" davis346:davis346_building_dense evk3-hd:gen3_vga_dense_evt2 \
        eecvs:dvs128_walking_moderate >>"$work/plan"
else
    echo "skipped: recordings: there is no $data"
fi
cameras <"$work/plan"
guest -i -- all
