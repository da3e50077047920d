# What the scripts of the peers share.
# shellcheck shell=bash

# Something cannot be had here: no error of ours.
missing() { echo "peers: $1" >&2; exit 77; }

failed() { echo "peers: $1" >&2; exit 1; }

have() { command -v "$1" >/dev/null 2>&1; }

# Packages of the system, installed if that is possible; its lists may be too old for it at first.
packages() {
    local install=(apt-get install -y -qq -o DPkg::Lock::Timeout=300 "$@")
    have apt-get || return
    "${install[@]}" >/dev/null 2>&1 && return
    apt-get update -qq >/dev/null 2>&1 && "${install[@]}" >/dev/null 2>&1
}

# Of two scripts at a time that fill a folder, one does; the other then finds it filled.
alone() {
    mkdir -p "$1"
    exec 9>"$1/lock"
    ! have flock || flock 9
}

# Checksum of files by name and content, and of words.
checksum() { { find "$@" -type f -print0 | sort -z | xargs -0 sha256sum; cat; } | sha256sum | cut -d' ' -f1; }

# The absolute path of a folder, which is made.
absolute() { mkdir -p "$1" && (cd "$1" && pwd); }
