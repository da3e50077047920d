#!/usr/bin/env bash
# Measures every record of the project anew, and writes the sections of README.md and METHODOLOGY.md that are
# made of them: host-harness/record.sh [PART...], all parts unless some are named:
#
#   demo           record/demo.json          README: demo
#   kernels        record/kernels.json       README: host kernels
#   rates          record/rates.json         README: rates; METHODOLOGY: rate and distortion
#   skips          record/skips.json         METHODOLOGY: skips
#   rate-control   record/rate-control.json  README: rate control
#   keep-order     record/keep-order.json    README: keep order
#   exact-times    record/exact-times-*.json README: exact times
#   read-speed     record/read-speed.json    README: read speed; Python's packages from the network
#   ros-delay      record/ros-delay.json     README: ros delay
#   hub-load       record/hub-load.json      README: hub load; of emulated scenes
#   report         record/results.json       README: report; half an hour
#   instructions   ../firmware/instructions.json, README: instructions
#   mcu-kernels    ../firmware/kernels.json  README: kernels
#
# All but the demo is of the recordings in ../shared/data, beside the project. Times of a clock (demo, kernels,
# skips, read-speed, ros-delay, hub-load, report) want a machine that does nothing else; all other figures are the
# same in every run.
set -euo pipefail
cd "$(dirname "$0")/.."

record=host-harness/record
eecvs() { cargo run --release --quiet --features host-harness/zstd -- "$@"; }
# Writes the sections of records that another program has written.
sections() { EECVS_BLESS=1 cargo test --quiet -p host-harness --lib every_section_of_the_documents; }
# A test that writes what it measures in place of comparing it; one after the other, as they write one README.
bless() { EECVS_BLESS=1 cargo test --release --quiet -p eecvs-tests --test "$1" "$2" -- --test-threads=1; }

part() {
    case $1 in
        demo)
            eecvs demo --overwrite -o target/demo --save README.md --record "$record"
            ;;
        kernels) eecvs bench --save README.md --record "$record" ;;
        rates) eecvs bench --rate --save README.md --save METHODOLOGY.md --record "$record" ;;
        skips) eecvs bench --skips --save METHODOLOGY.md --record "$record" ;;
        rate-control) bless rate_control a_flood_fits_its_link ;;
        keep-order) bless keep_order recordings_come_back_in_order ;;
        exact-times) bless exact_times come_back_with_the_documented_exactness ;;
        read-speed)
            host-harness/read_speed.sh --record "$record/read-speed.json"
            sections
            ;;
        ros-delay)
            eecvs-ros/delay.sh --record "$record/ros-delay.json"
            sections
            ;;
        hub-load)
            eecvs-hub/load.sh --record "$record/hub-load.json"
            sections
            ;;
        report) eecvs report -o "$record" --save README.md ;;
        instructions) firmware/instructions.sh --save ;;
        mcu-kernels) firmware/kernels.sh --save ;;
    esac
}

parts=(demo kernels rates skips rate-control keep-order exact-times read-speed ros-delay hub-load report instructions mcu-kernels)
for name in "$@"; do
    if [[ " ${parts[*]} " != *" $name "* ]]; then
        echo "host-harness/record.sh: no part '$name'; there are: ${parts[*]}" >&2
        exit 2
    fi
done
[ $# = 0 ] || parts=("$@")
for name in "${parts[@]}"; do
    echo "=== $name"
    part "$name"
done
