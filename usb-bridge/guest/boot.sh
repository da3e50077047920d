#!/usr/bin/env bash
# Runs a command in a virtual machine that has a real kernel's USB, and ends with its exit status:
#
#   boot.sh [-s SOCKET]... [-f FILE]... [-i] PROGRAM [ARGUMENT...]
#
# -s SOCKET   a usbredir device that waits at this Unix socket, on an xHCI bus: the first at port 1, up
#             to 15 are possible
# -f FILE     a file, a program or a folder for the guest's root, under its own name; several are possible
# -i          with the kernel's USB/IP host (vhci-hcd)
#
# The guest has a kernel of Debian with its modules of USB, busybox, PROGRAM with its libraries, and
# nothing else: no udev, no network but its own. Emulated without the host's CPU (TCG): its time is
# no measure of anything. Files are kept in target/guest. Exit status 77: something is missing that
# cannot be installed.
set -euo pipefail

GUEST_SECONDS=${GUEST_SECONDS:-900}
cache=$(realpath -m "${CARGO_TARGET_DIR:-$(dirname "$0")/../../target}")/guest

missing() { echo "guest: $1" >&2; exit 77; }

# A package's program, installed if that is possible.
need() {
    command -v "$1" >/dev/null 2>&1 && return
    echo "installing $2" >&2
    {
        install() { apt-get install -y -qq --no-install-recommends "$1"; }
        # The lists of packages may be too old for it at first.
        command -v apt-get && { install "$2" || { apt-get update -qq && install "$2"; }; }
    } >/dev/null 2>&1 || missing "there is no $1, and apt-get cannot install $2"
}

# The kernel and the modules, in the order in which they need each other; never installed.
modules=('*/usb/common/usb-common' '*/usb/core/usbcore' '*/usb/host/xhci-hcd' '*/usb/host/xhci-pci'
    '*/usb/usbip/usbip-core' '*/usb/usbip/vhci-hcd')
load=4
kernel() {
    [ ! -e "$cache/kernel/complete" ] || return 0
    local package folder
    command -v apt-get >/dev/null 2>&1 || missing "apt-get is missing, which fetches the guest's kernel"
    folder=$(mktemp -d)
    fetch() {
        package=$(apt-cache depends linux-image-amd64 2>/dev/null |
            awk '/Depends: linux-image-[0-9]/ { print $2; exit }')
        [ -n "$package" ] || return 1
        echo "fetching $package" >&2
        (cd "$folder" && apt-get download -qq "$package" >/dev/null 2>&1)
    }
    if ! fetch && ! { apt-get update -qq >/dev/null 2>&1 && fetch; }; then
        rm -r "$folder"
        missing "apt-get cannot download a kernel (linux-image-amd64)"
    fi
    rm -rf "$cache/kernel"
    mkdir -p "$cache/kernel"
    dpkg-deb --fsys-tarfile "$folder/$package"_*.deb |
        tar -x -C "$folder" --wildcards './boot/vmlinuz-*' "${modules[@]/%/.ko}"
    mv "$folder"/boot/vmlinuz-* "$cache/kernel/vmlinuz"
    find "$folder" -name '*.ko' -exec mv {} "$cache/kernel/" \;
    rm -r "$folder"
    touch "$cache/kernel/complete"
}

sockets=()
files=()
while getopts s:f:i option; do
    case $option in
        s) sockets+=("$OPTARG") ;;
        f) files+=("$OPTARG") ;;
        i) load=6 ;;
        *) exit 2 ;;
    esac
done
shift $((OPTIND - 1))
[ $# -gt 0 ] || { echo "usage: boot.sh [-s SOCKET]... [-f FILE]... [-i] PROGRAM [ARGUMENT...]" >&2; exit 2; }

need qemu-system-x86_64 qemu-system-x86
need busybox busybox-static
kernel

work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
root=$work/root
mkdir -p "$root"/{bin,dev,proc,sys,tmp,modules}
cp "$(command -v busybox)" "$root/bin/busybox"
# Without what debuggers read, which is most of it and takes the guest long to unpack.
bare() {
    if [ -d "$1" ]; then
        cp -r "$1" "$2"
        return
    fi
    cp "$1" "$2"
    ! command -v strip >/dev/null 2>&1 || strip "$2/$(basename "$1")" 2>/dev/null || true
}
bare "$1" "$root/bin"
for file in "${files[@]}"; do bare "$file" "$root"; done
# Programs, and what programs load, with the libraries that they need.
loaded=("$1")
for file in "${files[@]}"; do
    if [ -d "$file" ]; then
        mapfile -t -O "${#loaded[@]}" loaded < <(find "$file" -type f \( -perm -u+x -o -name '*.so*' \))
    else
        loaded+=("$file")
    fi
done
for file in "${loaded[@]}"; do
    # What is not a program has no libraries.
    for library in $({ ldd "$file" 2>/dev/null || true; } | grep -o '/[^ )]*'); do
        mkdir -p "$root$(dirname "$library")"
        cp "$library" "$root$library"
    done
done
for module in "${modules[@]:0:load}"; do
    cp "$cache/kernel/${module##*/}.ko" "$root/modules/"
    echo "/bin/busybox insmod /modules/${module##*/}.ko"
done >"$work/insmod"
{
    echo '#!/bin/busybox sh'
    echo 'export PATH=/bin RUST_BACKTRACE=1'
    echo '/bin/busybox --install -s /bin'
    echo 'mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev'
    echo 'mount -t tmpfs tmp /tmp; ifconfig lo 127.0.0.1 up'
    cat "$work/insmod"
    printf '%q ' "$(basename "$1")" "${@:2}"
    echo
    # The port's device: 16 more, as a guest that dies ends QEMU with a small status, too.
    echo 'status=$?; [ $status -lt 100 ] || status=100'
    echo 'printf "\\$(printf %o $((status + 16)))" | dd of=/dev/port bs=1 seek=244 2>/dev/null'
    echo 'poweroff -f'
} >"$root/init"
chmod +x "$root/init"
(cd "$root" && find . | busybox cpio -o -H newc 2>/dev/null | gzip -1) >"$work/initramfs"

devices=()
for number in "${!sockets[@]}"; do
    devices+=(-chardev "socket,id=c$number,path=${sockets[number]}"
        -device "usb-redir,chardev=c$number,bus=x.0,port=$((number + 1))")
done
status=0
timeout --foreground "$GUEST_SECONDS" qemu-system-x86_64 \
    -M pc -accel tcg,thread=multi -cpu max -m 512 -nodefaults -no-reboot -nographic \
    -serial stdio -monitor none -device isa-debug-exit,iobase=0xf4,iosize=1 \
    -device qemu-xhci,id=x,p2=15,p3=15 "${devices[@]}" \
    -kernel "$cache/kernel/vmlinuz" -initrd "$work/initramfs" \
    -append "console=ttyS0 quiet loglevel=4 panic=-1" </dev/null || status=$?
# Twice what the guest wrote, plus one.
case $status in
    124) echo "guest: it did not end within $GUEST_SECONDS s" >&2; exit 1 ;;
    *) [ $((status % 2)) = 1 ] && [ "$status" -ge 33 ] ||
        { echo "guest: it crashed (QEMU's exit status is $status)" >&2; exit 1; } ;;
esac
exit $(((status - 33) / 2))
