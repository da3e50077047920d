#!/usr/bin/env bash
# Makes the windows that `instructions` encodes: firmware/target/cuts/{recordings,emulator}/*.words
# Recordings are taken from ../shared/data; where they are not there, their cuts are empty.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo run --quiet --release --locked -p eecvs-tests --bin instructions -- \
    cuts firmware/target/cuts ../shared/data
