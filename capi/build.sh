#!/usr/bin/env bash
# Builds libeecvs: capi/build.sh [TARGET [FEATURES]]
#
#   without TARGET   for this machine: the static and the shared library, encoder and decoder
#   TARGET           a microcontroller's, such as thumbv7em-none-eabihf: the static library, the encoder alone.
#                    FEATURES are of full, or of budget, dense, quick and transform, and small: without any, it has the
#                    fast coder alone; with `small` its code is for flash, not for speed.
#                    Cortex-M33 and later cores with the DSP extension run the library of thumbv7em-none-eabihf, which
#                    uses it; that of thumbv8m.main-none-eabihf does without
#
# The last line printed is the folder with the libraries.
set -euo pipefail
cd "$(dirname "$0")/.."

target=${1:-}
folder=${CARGO_TARGET_DIR:-target}
if [ -z "$target" ]; then
    cargo build --release --locked --package eecvs-capi >&2
    cd "$folder/release"
else
    [ -d "$(rustc --print target-libdir --target "$target")" ] || rustup target add "$target" >&2
    case ",${2:-}," in *,small,*)
        export CARGO_PROFILE_RELEASE_OPT_LEVEL=z
        # By its own threshold for this level LLVM leaves checks in functions of their own, where it no longer sees that
        # they always hold: the library could panic.
        export RUSTFLAGS="${RUSTFLAGS:-} -C llvm-args=-inline-threshold=25" ;;
    esac
    # Small and without unwinding, as images are.
    CARGO_PROFILE_RELEASE_LTO=fat CARGO_PROFILE_RELEASE_CODEGEN_UNITS=1 CARGO_PROFILE_RELEASE_PANIC=abort \
        cargo rustc --release --locked --package eecvs-capi --lib --target "$target" --no-default-features \
        --features "${2:-}" --crate-type staticlib >&2
    cd "$folder/$target/release"
fi
# The name by which C programs link it.
cp libeecvs_capi.a libeecvs.a
[ -n "$target" ] || for shared in libeecvs_capi.so libeecvs_capi.dylib; do
    [ ! -e "$shared" ] || cp "$shared" "${shared/_capi/}"
done
pwd
