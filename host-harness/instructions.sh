#!/usr/bin/env bash
# Counts the instructions of the host's encoder, decoder and readers in Valgrind:
# host-harness/instructions.sh [--save|--check]
#
#            prints the table
#   --save   also takes the counts over into host-harness/instructions.json, which is committed
#   --check  compares with those and fails where a case has grown by over 10 %; status 77 where they
#            are of another compiler or target, and do not compare
#
# The counts are the same in every run, and on every x86-64 processor.
set -euo pipefail
cd "$(dirname "$0")"

case ${1:-} in
    '') action=print ;;
    --save) action=save ;;
    --check) action=check ;;
    *) sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
esac
exec cargo run --quiet --release --locked -p eecvs-tests --bin host_instructions -- "$action" instructions.json
