#!/usr/bin/env bash
# Makes a library for Arduino and PlatformIO of libeecvs: arduino/package.sh FOLDER [CORE...]
#
# FOLDER/eecvs has the header, an example and an archive for each core: of these, or of those named.
#
#   cortex-m0plus cortex-m3 cortex-m4 cortex-m7 cortex-m33   by the names that Arduino's boards and PlatformIO have for them
#   esp32c3 esp32c6                                          RISC-V
#   native                                                   this machine, for PlatformIO's environment of that name
set -euo pipefail
cd "$(dirname "$0")"

[ $# -gt 0 ] || { sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2; }
mkdir -p "$1"
out=$(cd "$1" && pwd)/eecvs
shift
[ $# -gt 0 ] || set -- cortex-m0plus cortex-m3 cortex-m4 cortex-m7 cortex-m33 esp32c3 esp32c6 native
[ ! -e "$out" ] || { echo "$out is there already: remove it, or name another folder" >&2; exit 1; }

version=$(sed -n 's/^version = "\(.*\)"/\1/p' ../../Cargo.toml | head -n 1)
part=$out.part
rm -rf "$part"
mkdir -p "$part/src"
for core in "$@"; do
    case $core in
        cortex-m0plus) target=thumbv6m-none-eabi ;;
        cortex-m3) target=thumbv7m-none-eabi ;;
        # Arduino's cores for these pass floating-point numbers in registers, as the target does; those of the M33 have the
        # DSP extension.
        cortex-m4 | cortex-m7 | cortex-m33) target=thumbv7em-none-eabihf ;;
        esp32c3) target=riscv32imc-unknown-none-elf ;;
        esp32c6) target=riscv32imac-unknown-none-elf ;;
        native) target= ;;
        *) echo "no archive is known for the core $core" >&2; exit 2 ;;
    esac
    folder=$(CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$PWD/../../target/capi} ../build.sh "$target")
    mkdir -p "$part/src/$core"
    cp "$folder/libeecvs.a" "$part/src/$core/"
done
cp ../include/eecvs.h "$part/src/"
cp -r examples platformio.py ../../LICENSE "$part/"
for file in library.properties library.json; do
    sed "s|@VERSION@|$version|" "$file.in" >"$part/$file"
done
mv "$part" "$out"
echo "$out"
