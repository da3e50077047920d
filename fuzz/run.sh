#!/bin/sh
# Runs fuzz targets and fails on a crash: run.sh [SECONDS] [TARGET...]
# SECONDS per target (default 5), all targets by default. Works with stable Rust: without a
# sanitizer, whose work the compiler's own checks do in safe code. Needs
# `cargo install cargo-fuzz --locked`.
set -eu
cd "$(dirname "$0")"
seconds=${1:-5}
[ $# -gt 0 ] && shift
[ $# -gt 0 ] || set -- $(ls fuzz_targets | sed 's/\.rs$//')
for target in "$@"; do
    echo "== $target, $seconds s"
    mkdir -p "corpus/$target"
    # The first folder collects new inputs; the second holds the committed seeds.
    cargo fuzz run --sanitizer none "$target" "corpus/$target" $(ls -d "seeds/$target" 2>/dev/null) -- \
        -max_total_time="$seconds" -max_len=8192 -rss_limit_mb=1024 -timeout=10 \
        -verbosity=0 -print_final_stats=1
done
