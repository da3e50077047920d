# Read by check.sh and recordings.sh: cameras that `eecvs-usb simulate` offers to a guest.
#
# Needs `guest-check` and `eecvs-usb`, which `cargo test -p usb-bridge` builds.

here=$(dirname "${BASH_SOURCE[0]}")
data=$here/../../../shared/data
programs=${CARGO_TARGET_DIR:-$here/../../target}/debug
check=$programs/examples/guest-check
work=$(mktemp -d)
# The simulations, what boot.sh is told of them, and what the guest is to find.
started=()
sockets=()
wanted=()
stop() {
    [ ${#started[@]} -eq 0 ] || kill "${started[@]}" 2>/dev/null || true
    rm -r "$work"
}
trap stop EXIT

# What the devices' side has to say is of interest where something fails.
fail() { cat "$work/log" >&2; exit "$1"; }

# A program that offers devices at a socket: `offer NAME PROGRAM ARGUMENT...`, with SOCKET for the path.
offer() {
    local socket=$work/$1
    shift
    "${@/#SOCKET/$socket}" >>"$work/log" 2>&1 &
    started+=($!)
    sockets+=(-s "$socket")
}

# A simulation for every line of a plan on stdin (plan.rs).
cameras() {
    local model name width height start digest file port
    while read -r model name width height start digest file; do
        offer "$model-$name" "$programs/eecvs-usb" simulate "$model" "$file" --rate max --once --json \
            --width "$width" --height "$height" --start-us "$start" --usbredir SOCKET
        port=$((${#sockets[@]} / 2))
        wanted+=("$port" "$model" "$name" "$digest")
    done
}

# Boots a guest that has all that was offered: `guest OPTION... -- COMMAND`; ends where it fails.
guest() {
    local socket status=0 process options=()
    while [ "$1" != -- ]; do
        options+=("$1")
        shift
    done
    for socket in "${sockets[@]}"; do
        for _ in $(seq 1200); do
            [ "$socket" != -s ] && [ ! -S "$socket" ] || break
            sleep 0.1
        done
    done
    "$here/boot.sh" "${options[@]}" "${sockets[@]}" -f "$programs/eecvs-usb" \
        "$check" "${@:2}" "${wanted[@]}" || status=$?
    [ "$status" = 0 ] || fail "$status"
    # Each ends in order when the guest has left.
    for process in "${started[@]}"; do
        wait "$process" || fail $?
    done
    started=()
    sockets=()
    wanted=()
}
