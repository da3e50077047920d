#!/usr/bin/env bash
# Events per second that recordings are read with, here and by other libraries:
# host-harness/read_speed.sh [--record FILE] [--rounds N]
#
# Measures `eecvs bench --read` beside faery, aedat, expelliarmus and evt3, as Python gives them: whole arrays,
# converted no further. All are on one and the same processor, one after the other in every round (5 unless
# told), and the best of all rounds counts. The files are the recordings in ../shared/data, beside the project,
# and two of them repeated to some 12 million events in each format.
#
#   --record FILE  also writes the rows as a record, of which README.md's table is made
#
# Wants python3 with venv, the network for the packages, and a machine that does nothing else.
set -euo pipefail
cd "$(dirname "$0")/.."

record=() rounds=5
while [ $# -gt 0 ]; do
    case $1 in
        --record) record=(--record "$(realpath -m "${2:?--record wants a file}")"); shift 2 ;;
        --rounds) rounds=${2:?--rounds wants a number}; shift 2 ;;
        *) sed -n '2,12s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
    esac
done
command -v python3 >/dev/null || { echo "host-harness/read_speed.sh: wants python3" >&2; exit 2; }

work=target/read_speed
mkdir -p "$work"
[ -x "$work/venv/bin/python" ] || python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy faery==0.7.1 aedat==2.3.0 expelliarmus==1.1.12 evt3==0.4.1
cargo build --release --quiet
eecvs=${CARGO_TARGET_DIR:-target}/release/eecvs

# One processor for everything, threads of the libraries' own included.
pin=()
command -v taskset >/dev/null && pin=(taskset -c "$(taskset -cp $$ | sed 's/.*[ ,-]//')")
exec "${pin[@]}" "$work/venv/bin/python" tests/peers/read_speed.py "$eecvs" ../shared/data "$work" \
    --rounds "$rounds" "${record[@]}"
