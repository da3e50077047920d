#!/usr/bin/env bash
# Builds the images of a machine: firmware/build.sh [MACHINE [BINARY [portable]]]
#
#   netduinoplus2   STM32F405, Cortex-M4F: boards, and QEMU's machine of that name (the default)
#   small           STM32F405 with 64 KiB of flash and 48 KiB of RAM used: the fast coder and one window; `encoder`
#                   alone, on boards and in QEMU's netduinoplus2
#   usb             STM32F405 with USB as its link, on boards only; `encoder` alone. EECVS_CRYSTAL_MHZ
#                   is the board's crystal: 12 unless set
#   mps2-an385      Cortex-M3 in QEMU
#   mps2-an385-m0   the instructions of a Cortex-M0+ in QEMU, on that Cortex-M3, which has them all
#   mps2-an386      Cortex-M4 in QEMU
#   mps2-an500      Cortex-M7 in QEMU
#   mps2-an505      Cortex-M33 in QEMU, by the Cortex-M4's instructions, DSP included
#   mps3-an547      Cortex-M55 in QEMU, likewise
#   microbit        Cortex-M0 in QEMU: no FPU, no DSP instructions, no atomics; `golden` alone
#
# The images are firmware/target/MACHINE/TARGET/release/{encoder,golden}; the last line printed is
# their folder. BINARY `instructions` needs its cuts: cargo xtask instructions makes them and calls this.
# BINARY `kernels` is for `cargo xtask kernels`, on netduinoplus2 and mps2-an500; BINARY `sensor` for `cargo xtask sensor`,
# on mps2-an385, an386 and an500. With `portable`, the core's assembly is left out.
set -euo pipefail
cd "$(dirname "$0")"

machine=${1:-netduinoplus2}
flags=()
case $machine in
    netduinoplus2) target=thumbv7em-none-eabihf feature=stm32f405 ;;
    small) target=thumbv7em-none-eabihf feature=stm32f405 ;;
    usb) target=thumbv7em-none-eabihf feature=stm32f405,usb ;;
    mps2-an385) target=thumbv7m-none-eabi feature=mps2 ;;
    mps2-an385-m0) target=thumbv6m-none-eabi feature=mps2 ;;
    mps2-an386) target=thumbv7em-none-eabihf feature=mps2 ;;
    mps2-an500) target=thumbv7em-none-eabihf feature=mps2 flags=(-C target-cpu=cortex-m7) ;;
    mps2-an505) target=thumbv7em-none-eabihf feature=an505 ;;
    mps3-an547) target=thumbv7em-none-eabihf feature=an547 ;;
    microbit) target=thumbv6m-none-eabi feature=microbit ;;
    *) sed -n '2,20s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
esac

case ${2:-} in
    instructions) feature+=,cuts ;;
    kernels) feature+=,kernels ;;
    sensor) feature+=,simulated ;;
esac
[ "${3:-}" != portable ] || feature+=,portable
command=(cargo build --release --locked --features "$feature" --target "$target" --target-dir "target/$machine")
if [ -n "${2:-}" ]; then
    command+=(--bin "$2")
elif [ "$machine" = microbit ]; then
    command+=(--bin golden)
elif [ "$machine" = usb ] || [ "$machine" = small ]; then
    command+=(--bin encoder)
fi
[ "$machine" != small ] || command+=(--no-default-features)
# Its 256 KiB of flash, of which tables take a third, want small code, and have no room for the quick coder.
if [ "$machine" = microbit ]; then
    command+=(--no-default-features --features full)
    export CARGO_PROFILE_RELEASE_OPT_LEVEL=s
fi
# The log tells places by the image's debug information, whatever the host's programs are built with.
unset CARGO_PROFILE_RELEASE_DEBUG
export RUSTFLAGS="${flags[*]}" DEFMT_LOG="${DEFMT_LOG:-info}"
# What the machines' builds have in common, such as derive macros, is built once.
export CARGO_BUILD_BUILD_DIR=$PWD/target/build

has_library() { [ -d "$(rustc --print target-libdir --target "$target")" ]; }

# Of two builds at a time that both miss it, one adds it.
add_library() (
    mkdir -p target
    exec 9>target/library.lock
    ! command -v flock >/dev/null || flock 9
    has_library || rustup target add "$target" >&2
)

if ! has_library; then
    if command -v rustup >/dev/null && add_library; then
        :
    elif [ -d /usr/lib/rustlib/src/rust/library ] && [ -x /usr/bin/rustc ]; then
        # The distribution's compiler with its own library sources.
        export RUSTC=/usr/bin/rustc RUSTC_BOOTSTRAP=1
        command+=(-Z build-std=core)
        lld=$(find "$(rustc --print sysroot)" /usr/lib -name rust-lld -print -quit 2>/dev/null || true)
        [ -z "$lld" ] || PATH=$(dirname "$lld"):$PATH
    else
        echo "firmware/build.sh: the core library for $target is missing. Either of these installs it:" >&2
        echo "  rustup target add $target" >&2
        echo "  apt-get install rustc-web rust-web-src lld    (Debian)" >&2
        exit 1
    fi
fi
"${command[@]}" >&2
echo "$PWD/target/$machine/$target/release"
