#!/usr/bin/env bash
# Every shared recording, by every model whose sensor it fits, over the guest's real USB (boot.sh):
# `eecvs-usb simulate` on the host, `eecvs-usb capture` in the guest, and every event is compared:
#
#   recordings.sh [MODEL|MODEL:RECORDING]...
#
# Device's times cross 2^31 us. Needs what check.sh needs; exit status 77 as there, or where the recordings
# are absent.
set -euo pipefail
. "$(dirname "$0")/offer.sh"

# Ports of a guest's controller.
PORTS=15

if [ ! -e "$data/REFERENCE.json" ]; then
    echo "skipped: recordings: there is no $data" >&2
    exit 77
fi
"$check" recordings "$data" "$@" | sort -s -k 1,1 >"$work/plan"
[ -s "$work/plan" ] || { echo "no recording fits: $*" >&2; exit 2; }
split -l "$PORTS" "$work/plan" "$work/part-"
for part in "$work"/part-*; do
    cameras <"$part"
    guest -- captures
done
