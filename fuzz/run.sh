#!/bin/sh
# Runs fuzz targets and fails on a crash: run.sh [SECONDS] [TARGET...]
# SECONDS per target (default 5), all targets by default; the readers' are read_FORMAT, with a format's
# name as `eecvs info` prints it. Works with stable Rust: without a sanitizer, whose work the compiler's
# own checks do in safe code. Needs `cargo install cargo-fuzz --locked`.
set -eu
cd "$(dirname "$0")"
seconds=${1:-5}
[ $# -gt 0 ] && shift
if [ $# = 0 ]; then
    # The names in the table of formats; a folder is no file.
    formats=$(sed -n 's/^    name: "\(.*\)",$/read_\1/p' ../crates/event-files/src/*.rs ../crates/event-files/src/*/*.rs | grep -v '^read_rosbag2$')
    set -- $(ls fuzz_targets | sed 's/\.rs$//; /^read$/d') $formats
fi
# Builds of many units of code take half as long, those of one run up to three times as fast.
units=16
[ "$seconds" -lt 60 ] || units=1
for target in "$@"; do
    echo "== $target, $seconds s"
    mkdir -p artifacts "corpus/$target"
    program=$target
    case $target in
        read_*) program=read; export EECVS_FORMAT="${target#read_}" ;;
    esac
    # The first folder collects new inputs; the second holds the committed seeds.
    cargo fuzz run --sanitizer none --codegen-units "$units" "$program" "corpus/$target" $(ls -d "seeds/$target" 2>/dev/null) -- \
        -max_total_time="$seconds" -max_len=8192 -rss_limit_mb=1024 -timeout=10 \
        -artifact_prefix="artifacts/$target-" -verbosity=0 -print_final_stats=1
done
