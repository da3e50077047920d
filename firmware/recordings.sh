#!/usr/bin/env bash
# The encoder's image against the host's encoder, frame by frame, on an emulated scene and on real
# recordings, in every transform: firmware/recordings.sh [EVENTS]
#
# EVENTS: of each recording the first so many; without it all of them, which takes some 20 minutes.
set -euo pipefail
cd "$(dirname "$0")/.."

limit=()
[ $# -eq 0 ] || limit=(--events "$1")
data=../shared/data
scans=$data/dvxl_person_moderate/data_sample.aedat4
recordings=(
    "$data/davis346_building_dense/davis.aedat4"
    "$data/dvs128_walking_moderate/alex_walking_for_10secs.aedat"
    "$data/gen3_vga_dense_evt2/evt2.raw"
    "$scans"
)
hot=$(mktemp)
trap 'rm -f "$hot"' EXIT
printf '%s\n' 64,48 65,48 90,60 >"$hot"
image=$(firmware/build.sh netduinoplus2 encoder)/encoder
cargo build --release --quiet
eecvs=target/release/eecvs

run() {
    local name=$1 json
    shift
    json=$("$eecvs" mcu "$@" --image "$image" --json) || { echo "$name: $json" >&2; return 1; }
    printf '%-32s %s\n' "$name" "$(tr -d ' \n' <<<"$json")"
}

# Every input in every mode, two at a time: the events, the same by the dense coder without some pixels, the
# same filtered and under a budget that does not take them all, then the regime's transform, then each at both
# M. The sensor that scans is for the dense coder alone.
modes=("fast" "dense" "budget" "auto" "dct 8" "dct 16" "dtft 8" "dtft 16" "dwt 8" "dwt 16")
inputs=("")
for recording in "${recordings[@]}"; do
    if [ -e "$recording" ]; then
        inputs+=("$recording")
    else
        echo "skipped: there is no $recording"
    fi
done
failed=0
for input in "${inputs[@]}"; do
    for mode in "${modes[@]}"; do
        [ "$input" != "$scans" ] || [ "$mode" = dense ] || continue
        read -r transform m <<<"$mode"
        arguments=(--mode transform --transform "$transform" ${m:+-m "$m"})
        case $transform in
            fast) arguments=(--mode hybrid --coder fast) ;;
            dense) arguments=(--mode hybrid --coder dense --hot-pixels "$hot") ;;
            budget) arguments=(--mode hybrid --isolated --bytes-per-second 60000) ;;
        esac
        name="${input:+$(basename "$(dirname "$input")") }${input:-scene }$mode"
        [ -z "$input" ] || { arguments+=("$input" "${limit[@]}"); name="$(basename "$(dirname "$input")") $mode"; }
        run "$name" "${arguments[@]}" &
        # At most two at once.
        while [ "$(jobs -rp | wc -l)" -ge 2 ]; do
            wait -n || failed=1
        done
    done
done
while [ -n "$(jobs -rp)" ]; do
    wait -n || failed=1
done
exit "$failed"
