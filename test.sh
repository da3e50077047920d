#!/usr/bin/env bash
# Every check of the project, headless. `./test.sh` runs all stages except the long ones, two at a time;
# `./test.sh STAGE...` runs the named ones, one after the other:
#
#   lint      formatting, clippy, documentation
#   unit      unit, property, golden, format, end-to-end tests; shared recordings where present;
#             instructions of the host's encoder, decoder and readers
#   nostd     the core and the USB class without std
#   firmware  the images in QEMU: golden vectors, stack, code, instructions, recordings
#   cores     the library for C: its programs on this machine and, in QEMU, on the cores of microcontrollers; their sizes;
#             what finds it; the images on all cores: only when it is named (the unit stage has the library's, too)
#   usb       the USB link: its tests, libusb against a mocked device, simulated cameras in a guest
#             with a real kernel
#   links     the tests of hubs and of ROS 2's nodes, which wait for each other's messages more than they compute, and
#             then those that the unit stage has not come to: only beside that stage, of which they are a part otherwise
#   metrics   the metrics against scipy and scikit-image, volumes against numpy, in a Python of its own: only when it
#             is named (the unit stage compares them where the system's Python has these)
#   peers     the formats against independent decoders, and simulated cameras against drivers of others, in a Python
#             of its own with their packages: only when it is named (the unit stage compares them where the system's
#             Python has some)
#   python    the Python package: its tests and stubs, by the unit stage's build; when it is named, its wheel, built and
#             installed in a Python of its own, with the packages of others that its tests compare it with, and in clean
#             ones of the oldest and the newest version that is here, without Rust
#   torch     the Python package beside torch, in a Python of its own: only when it is named
#   page      the pages of `eecvs report` and of a hub in a browser, at the width of a desk and of a telephone: only
#             when it is named (the unit stage opens them where there is a browser)
#   ros       the nodes of ROS 2 against genuine ROS 2, Fast DDS in C++ and Cyclone DDS in C, which it makes: only
#             when it is named
#   usb-recordings   every shared recording by every model that it fits, both ways: minutes, and only when
#             it is named
#   neon      the vectors of ARM's larger cores, the core's tests of them in an emulator: only when it is named
#   fuzz      every fuzz target for FUZZ_SECONDS (default 2), minutes, and only when it is named (the unit stage
#             runs them on their seeds and on random bytes)
#   demo      the first command of the README: when it is named, as it stands there; beside the unit stage, by that
#             build
#
# What is missing is installed where that is possible; where it is not, the stage says so.
set -euo pipefail
cd "$(dirname "$0")"

# Features that are off by default but tested, in every build of the whole workspace alike.
FEATURES=(--features host-harness/onnx)

# Every test but those of documentation, from which names choose. With `--test NAME` in its place the dependencies have
# other features, and are built again.
TESTS=(--workspace "${FEATURES[@]}" --tests)

# Notes what a stage leaves out.
skip() { echo "skipped: $1"; echo "$1" >>"$SKIPPED"; }

# Whether a stage is one of those that run: what it has tested is not tested again.
ran() { [[ " $STAGES " == *" $1 "* ]]; }

have() { command -v "$1" >/dev/null 2>&1; }

# Runs a command while no other stage runs one so: what installs something fails beside another that does.
alone() (
    ! have flock || flock 9
    "$@"
) 9>>"$INSTALLING"

# Packages of the system, installed if that is possible; its lists may be too old for it at first.
packages() {
    have apt-get || return
    alone apt-get install -y -qq "$@" >/dev/null 2>&1 && return
    alone apt-get update -qq >/dev/null 2>&1 && alone apt-get install -y -qq "$@" >/dev/null 2>&1
}

# A rustup component, installed if rustup may.
component() {
    cargo "$1" --version >/dev/null 2>&1 && return
    echo "installing $2"
    have rustup && alone rustup component add "$2" >/dev/null 2>&1 && return
    skip "$1: rustup cannot add the component $2"
    return 1
}

lint() {
    if component fmt rustfmt; then
        cargo fmt --all --check
        cargo fmt --all --check --manifest-path fuzz/Cargo.toml
        cargo fmt --all --check --manifest-path firmware/Cargo.toml
    fi
    if component clippy clippy; then
        cargo clippy --workspace --all-targets "${FEATURES[@]}" -- -D warnings
    fi
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet
}

# What mocks a device for the real libusb, installed if that is possible.
umockdev() {
    have umockdev-wrapper && return
    echo "installing umockdev"
    packages umockdev && return
    skip "usb: libusb against a mocked device: apt-get cannot install umockdev"
}

# What runs the microcontroller's images, installed if that is possible.
emulator() {
    have qemu-system-arm && return
    echo "installing qemu-system-arm"
    packages qemu-system-arm
}

# What builds programs in C for microcontrollers, runs them, and builds others with CMake, installed if that is possible.
compilers() {
    local program
    for program in arm-none-eabi-gcc riscv64-unknown-elf-gcc qemu-system-riscv32 qemu-system-arm cmake pkg-config; do
        have "$program" && continue
        echo "installing compilers for microcontrollers"
        packages --no-install-recommends gcc-arm-none-eabi gcc-riscv64-unknown-elf qemu-system-misc qemu-system-arm cmake \
            pkg-config && return
        skip "cores: there is no $program and apt-get cannot install it"
        return 1
    done
}

cores() {
    compilers || true
    cargo test -p eecvs-capi -- --nocapture
    if emulator && firmware/build.sh mps2-an505; then
        # The Cortex-M33 and M55 run the code of the Cortex-M4.
        golden_vectors mps2-an505 mps3-an547
        cargo xtask cores
    fi
}

# Waits until the unit stage's build is there, or makes it: tests, commands, examples.
built() { cargo test --workspace "${FEATURES[@]}" --no-run --quiet; }

# A command of that build.
program() { echo "${CARGO_TARGET_DIR:-target}/debug/$1"; }

# The programs of the workspace's tests: name, folder of the package, path.
programs() {
    cargo test "${TESTS[@]}" --no-run --message-format json-render-diagnostics |
        sed -n 's|.*"manifest_path":"\([^"]*\)/Cargo.toml".*"name":"\([^"]*\)","src_path".*"profile":{[^}]*"test":true}.*"executable":"\([^"]*\)".*|\2\t\1\t\3|p'
}

# Runs the programs of tests that are named on stdin, each in its package's folder, as cargo does; not those that the
# other lane has taken.
each() {
    local name folder program
    while IFS=$'\t' read -r name folder program; do
        if ! mkdir "$STATE/taken-$(basename "$program")" 2>/dev/null; then
            [ -d "$STATE/taken-$(basename "$program")" ] || { echo "$STATE cannot be written"; return 1; }
            continue
        fi
        echo "     Running $name"
        (cd "$folder" && "$program") </dev/null
    done
}

# Those of hubs and of ROS 2's nodes, and the others.
LINKS='^(hubs|nodes)'$'\t'

links() {
    local list
    umockdev
    list=$(programs)
    [ "$(grep -cE "$LINKS" <<<"$list")" = 2 ] || { echo "there are no tests of hubs or of nodes"; return 1; }
    each < <(grep -E "$LINKS" <<<"$list")
    # What the unit stage comes to last.
    each < <(grep -vE "$LINKS" <<<"$list" | tac)
}

# A Python with h5py, for the filter of HDF5: that of the system, or one of its own. EECVS_H5PY names the latter.
h5py() {
    local folder=target/python
    ! python3 -c "import h5py" >/dev/null 2>&1 || return 0
    if ! "$folder/bin/python" -c "import h5py" >/dev/null 2>&1; then
        echo "installing h5py in $folder"
        python3 -m venv "$folder" >/dev/null 2>&1 ||
            { packages python3-venv && python3 -m venv "$folder" >/dev/null 2>&1; } &&
            "$folder/bin/pip" install -q h5py || return
    fi
    export EECVS_H5PY=$PWD/$folder/bin/python
}

unit() {
    umockdev
    h5py || skip "unit: the filter of HDF5 in h5py: pip cannot install h5py"
    # The firmware stage reports a missing one.
    emulator || true
    compilers || true
    target thumbv7em-none-eabihf || true
    # The dev profile checks arithmetic overflow and debug assertions.
    if ran links; then
        local list
        list=$(programs)
        [ "$(wc -l <<<"$list")" -ge 22 ] || { echo "programs of tests are missing"; return 1; }
        each < <(grep -vE "$LINKS" <<<"$list")
        cargo test --workspace "${FEATURES[@]}" --doc
    else
        cargo test --workspace "${FEATURES[@]}"
    fi
    # The bits must not depend on the profile. The firmware stage holds this host's release build against the images, which
    # have the golden vectors of the tests: elsewhere the tests do, built once more.
    { ran firmware && emulator && target thumbv7em-none-eabihf; } || cargo test --release -p eecvs-tests --test frames
    host_instructions
}

host_instructions() {
    local status=0
    if ! have valgrind; then
        echo "installing valgrind"
        if ! packages valgrind; then
            skip "unit: instructions: there is no valgrind and apt-get cannot install it"
            return
        fi
    fi
    cargo xtask host-instructions --check || status=$?
    [ "$status" != 77 ] || skip "unit: instructions: the saved counts are from another compiler or target"
    [ "$status" = 0 ] || [ "$status" = 77 ]
}

metrics() {
    local folder=target/python
    if ! "$folder/bin/python" -c "import numpy, scipy, skimage" >/dev/null 2>&1; then
        echo "installing numpy, scipy and scikit-image in $folder"
        if ! python3 -m venv "$folder" || ! "$folder/bin/pip" install -q numpy scipy scikit-image; then
            skip "metrics: pip cannot install numpy, scipy and scikit-image"
            return
        fi
    fi
    EECVS_PYTHON=$PWD/$folder/bin/python \
        cargo test "${TESTS[@]}" -- --nocapture metrics_reference:: volumes_reference::
}

# Each package is wanted, none is a must: a decoder that cannot be installed is left out, by its own line.
peers() {
    local folder=target/python package
    if ! [ -x "$folder/bin/pip" ] && ! python3 -m venv "$folder"; then
        skip "peers: python3 cannot create a virtual environment"
        return
    fi
    umockdev
    have zpaq || packages zpaq || skip "peers: apt-get cannot install zpaq"
    for package in numpy faery expelliarmus evt3 evlib aedat dv-processing neuromorphic-drivers event-stream rosbags mcap \
        mcap-ros2-support h5py hdf5plugin pyarrow polars pandas fastparquet scipy python-pcapng scapy; do
        "$folder/bin/pip" install -q "$package" || skip "peers: pip cannot install $package"
    done
    # One module of each is used, which needs none of the rest.
    for package in tonic dv; do
        "$folder/bin/pip" install -q --no-deps "$package" || skip "peers: pip cannot install $package"
    done
    EECVS_PYTHON=$PWD/$folder/bin/python \
        cargo test "${TESTS[@]}" -- --nocapture formats_peers:: clients:: rate::lossless::
}

# A Python of its own for the package, with packages: `package_home PACKAGE...`. EECVS_PYTHON3 names another version's.
package_home() {
    local folder=target/python-package python=${EECVS_PYTHON3:-python3}
    if ! have "$python" || ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 9))'; then
        skip "python: there is no Python of version 3.9 or later"
        return 1
    fi
    [ -x "$folder/bin/pip" ] || "$python" -m venv "$folder" >/dev/null 2>&1 ||
        { packages python3-venv && "$python" -m venv "$folder"; } || {
        skip "python: $python cannot create a virtual environment"
        return 1
    }
    "$folder/bin/pip" install -q "$@" || {
        skip "python: pip cannot install $*"
        return 1
    }
}

# The module of the tests' build, which checks arithmetic too, beside the package's sources in a folder: a wheel takes
# minutes. Then runs pytest of a Python with it: `with_module FOLDER PYTHON ARGUMENT...`.
with_module() {
    local module=$PWD/$1 python=$2
    shift 2
    cargo build --workspace "${FEATURES[@]}" --lib --tests --quiet
    rm -rf "$module"
    mkdir -p "$module"
    cp -r python/eecvs "$module/"
    rm -f "$module/eecvs/"_eecvs.*so
    cp "$(program lib_eecvs.so)" "$module/eecvs/_eecvs.abi3.so" 2>/dev/null ||
        cp "$(program lib_eecvs.dylib)" "$module/eecvs/_eecvs.abi3.so"
    EECVS_COMMAND=$PWD/$(program eecvs) PYTHONPATH=$module MYPYPATH=$module "$python" -m pytest -q -rs -p no:cacheprovider "$@"
}

python_module() {
    package_home numpy pytest mypy numcodecs || return 0
    with_module target/python-package/module target/python-package/bin/python python/tests
}

# The package beside torch, which Debian has for the system's own Python.
torch() {
    local folder=target/python-torch python=
    for python in "${EECVS_PYTHON3:-python3}" /usr/bin/python3; do
        ! "$python" -c "import torch" 2>/dev/null || break
        python=
    done
    if [ -z "$python" ]; then
        echo "installing python3-torch"
        python=/usr/bin/python3
        if ! packages python3-torch || ! "$python" -c "import torch"; then
            skip "torch: there is no Python with torch and apt-get cannot install python3-torch"
            return
        fi
    fi
    [ -x "$folder/bin/pip" ] || "$python" -m venv --system-site-packages "$folder" >/dev/null 2>&1 ||
        { packages python3-venv && "$python" -m venv --system-site-packages "$folder"; } || {
        skip "torch: $python cannot create a virtual environment"
        return
    }
    "$folder/bin/pip" install -q pytest || {
        skip "torch: pip cannot install pytest"
        return
    }
    with_module "$folder/module" "$folder/bin/python" python/tests/test_{torch,data,examples,readme,train}.py
}

# The package's wheel. What its tests need is a must; each other package is wanted, and what is left out without it the
# tests say themselves.
python() {
    local folder=target/python-package wheels=target/wheels package
    if ran unit; then
        python_module
        return
    fi
    package_home 'maturin>=1.7,<2' numpy pytest || return 0
    for package in mypy 'pyright[nodejs]' pyarrow polars pandas faery expelliarmus dv-processing evlib h5py scipy tqdm requests \
        numcodecs zarr ray; do
        "$folder/bin/pip" install -q "$package" || skip "python: pip cannot install $package"
    done
    # What its data sets need is left out.
    "$folder/bin/pip" install -q --no-deps tonic || skip "python: pip cannot install tonic"
    rm -rf "$wheels"
    # A folder of its own: in that of the other stages it would wait until they are built.
    CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-target/python-build} "$folder/bin/maturin" build --release --locked -q \
        -m python/Cargo.toml -i "$folder/bin/python" -o "$wheels"
    if [ "$(stat -c %s "$wheels"/*.whl)" -gt 10000000 ]; then
        echo "the wheel has more than 10 MB"
        return 1
    fi
    "$folder/bin/pip" install -q --force-reinstall --no-deps "$wheels"/*.whl
    # The installed package, not the sources beside the tests: from a folder without either.
    "$folder/bin/python" -m pytest -q -rs python/tests
    clean_installs "$wheels"/*.whl
}

# The Pythons of this machine that the wheel is for: version and path, the oldest first.
pythons() {
    local python
    for python in ${EECVS_PYTHON3:-} python3.{9..20} "${PYENV_ROOT:-$HOME/.pyenv}"/versions/*/bin/python3; do
        "$python" -c 'import sys; v = sys.version_info[:2]; v < (3, 9) or print("%d.%d" % v, sys.executable)' 2>/dev/null || true
    done | sort -t . -k 2n -u
}

# The wheel in clean environments of the oldest Python and of the newest, with what it depends on alone, and without Rust.
clean_installs() {
    local wheel=$1 found version python folder
    found=$(pythons)
    if [ "$(wc -l <<<"$found")" -lt 2 ]; then
        skip "python: the wheel in a second version: there is only ${found:-none}"
    fi
    while read -r version python; do
        folder=target/python-clean/$version
        rm -rf "$folder"
        if ! "$python" -m venv "$folder"; then
            skip "python: the wheel in Python $version: it cannot create a virtual environment"
            continue
        fi
        "$folder/bin/pip" install -q "$wheel"
        echo "the wheel in Python $version"
        env -i PATH="$PWD/$folder/bin" "$folder/bin/python" python/tests/installed.py
    done < <(sed -n '1p;1!{$p}' <<<"$found")
}

# The name of a browser that pages are opened in, as host-harness/tests/browser/mod.rs has them.
browser() {
    local name
    for name in chromium chromium-browser google-chrome google-chrome-stable; do
        ! "$name" --version >/dev/null 2>&1 || { echo "$name"; return; }
    done
    return 1
}

page() {
    local name=${EECVS_BROWSER:-}
    if [ -z "$name" ] && ! name=$(browser); then
        echo "installing chromium"
        if ! packages chromium || ! name=$(browser); then
            skip "page: there is no chromium and apt-get cannot install it"
            return
        fi
    fi
    # Named, it must run.
    EECVS_BROWSER=$name cargo test "${TESTS[@]}" -- --nocapture page::
}

# A target's core library, installed if rustup may.
target() {
    [ -d "$(rustc --print target-libdir --target "$1")" ] && return
    echo "installing the target $1"
    have rustup && alone rustup target add "$1" >/dev/null 2>&1
}

nostd() {
    local target check=check
    # A folder of its own: in that of the other stages it would wait until they are built.
    export CARGO_TARGET_DIR=target/nostd
    # Where it is there: it checks too, and what the lint stage does not see.
    ! component clippy clippy || check=clippy
    # A Cortex-M4F, and a core without atomics, FPU and DSP instructions.
    for target in thumbv7em-none-eabihf thumbv6m-none-eabi; do
        if ! target "$target"; then
            skip "nostd: rustup cannot add the target $target"
            continue
        fi
        # With defmt the firmware stage builds it, for both.
        RUSTFLAGS="-D warnings" cargo "$check" -p eecvs-nostd --target "$target"
        # Controllers of USB are in cores with atomics.
        [ "$target" = thumbv6m-none-eabi ] ||
            RUSTFLAGS="-D warnings" cargo "$check" -p eecvs-usb-class --target "$target"
    done
    # Its vectors; nothing runs there.
    if target aarch64-unknown-linux-gnu; then
        RUSTFLAGS="-D warnings" cargo "$check" -p eecvs-nostd --target aarch64-unknown-linux-gnu
    else
        skip "nostd: rustup cannot add the target aarch64-unknown-linux-gnu"
    fi
}

# The coders' vectors of ARM are tested where they run, beside plain Rust and with the frozen bits. The linker comes with
# Rust; nothing else of that machine is needed.
neon() {
    local target=aarch64-unknown-linux-musl
    if ! have qemu-aarch64; then
        echo "installing qemu-user"
        if ! packages qemu-user; then
            skip "neon: there is no qemu-aarch64 and apt-get cannot install it"
            return
        fi
    fi
    if ! target "$target"; then
        skip "neon: rustup cannot add the target $target"
        return
    fi
    CARGO_TARGET_DIR=target/neon CARGO_TARGET_AARCH64_UNKNOWN_LINUX_MUSL_LINKER=rust-lld \
        CARGO_TARGET_AARCH64_UNKNOWN_LINUX_MUSL_RUNNER=qemu-aarch64 \
        cargo test -p eecvs-nostd --target "$target" --lib
}

# Runs an image of a machine: `qemu MACHINE BINARY`. Its exit status is the image's.
qemu() {
    timeout 120 qemu-system-arm -M "${1%-m0}" -display none -monitor none -serial null -icount shift=0 \
        -semihosting-config enable=on,target=native \
        -kernel "$(firmware/build.sh "$1" "$2")/$2" </dev/null
}

# The golden vectors on machines: `golden_vectors MACHINE...`.
golden_vectors() {
    local machine
    for machine; do
        echo "golden vectors on $machine"
        qemu "$machine" golden
    done
}

firmware() {
    local features
    if ! emulator; then
        skip "firmware: there is no qemu-system-arm and apt-get cannot install it"
        return
    fi
    if ! firmware/build.sh netduinoplus2; then
        skip "firmware: there is no core library for the target"
        return
    fi
    # For boards alone: QEMU has no such USB controller. What is in the images is checked below.
    firmware/build.sh usb
    firmware/build.sh small
    if target thumbv7em-none-eabihf && component clippy clippy; then
        for features in full,quick,{stm32f405,mps2\,kernels,simulated} full,stm32f405,{sensor,usb\,sensor} stm32f405; do
            # In the environment of firmware/build.sh, so that what runs on the host is built once for both.
            env -u CARGO_PROFILE_RELEASE_DEBUG RUSTFLAGS= DEFMT_LOG=info CARGO_BUILD_BUILD_DIR=firmware/target/build \
                cargo clippy --manifest-path firmware/Cargo.toml --release --locked --no-default-features \
                --features "$features" --target thumbv7em-none-eabihf --target-dir firmware/target/clippy -- -D warnings
        done
    fi
    # Cortex-M4, M3, M0+, M7 and M0.
    golden_vectors netduinoplus2 mps2-an385 mps2-an385-m0 mps2-an500 microbit
    cargo xtask instructions --check
    cargo xtask kernels --check
    # A sensor at rising rates.
    cargo xtask sensor
    # Its output is the log's bytes, too.
    qemu netduinoplus2 faults | grep -ao "faults: .*"
    # The rest is last: until the unit stage is built, it waits.
    ran unit || cargo test "${TESTS[@]}" -- mcu::
    # The first events of every recording; without a number, all of them.
    built
    cargo xtask image-recordings --events "${RECORDING_EVENTS:-1500}" --eecvs "$(program eecvs)"
    cargo test "${TESTS[@]}" -- --nocapture firmware_image::
}

usb() {
    local status=0
    if ran unit; then
        # The guest runs programs of its build.
        built
    else
        umockdev
        cargo test -p usb-bridge
    fi
    usb-bridge/guest/check.sh || status=$?
    [ "$status" != 77 ] || skip "usb: the guest: something is missing, see above"
    [ "$status" = 0 ] || [ "$status" = 77 ]
}

# Each peer is wanted, none is a must.
ros() {
    local folder=target/ros peer status
    for peer in setup.sh fastdds/build.sh cyclone/build.sh; do
        status=0
        eecvs-ros/peers/$peer "$folder" || status=$?
        [ "$status" != 77 ] || skip "ros: $peer: something is missing, see above"
        [ "$status" = 0 ] || [ "$status" = 77 ] || return 1
    done
    [ -e "$folder/stamp" ] || return 0
    EECVS_ROS_PEERS=$PWD/$folder cargo test "${TESTS[@]}" -- --nocapture peers:: bags:: --skip formats_peers::
}

usb-recordings() {
    local status=0
    umockdev
    # Also builds what the guest runs.
    cargo test -p usb-bridge --no-run
    cargo test -p usb-bridge --test libusb -- --ignored --nocapture
    usb-bridge/guest/recordings.sh || status=$?
    [ "$status" != 77 ] || skip "usb-recordings: something is missing, see above"
    [ "$status" = 0 ] || [ "$status" = 77 ]
}

fuzz() {
    # Programs and seeds, which no other stage compiles.
    cargo check --manifest-path fuzz/Cargo.toml --locked --all-targets --target-dir target
    if ! have c++; then
        skip "fuzz: libFuzzer needs a C++ compiler"
        return
    fi
    if ! cargo fuzz --version >/dev/null 2>&1; then
        echo "installing cargo-fuzz"
        if ! cargo install cargo-fuzz --locked --quiet; then
            skip "fuzz: cargo-fuzz cannot be installed"
            return
        fi
    fi
    # A panic reports its line without it.
    CARGO_PROFILE_RELEASE_DEBUG=0 cargo xtask fuzz "${FUZZ_SECONDS:-2}"
}

# The demo's table in a document, without the rate, which is the machine's.
demo_table() { sed -n '/^<!-- demo: /,/^<!-- demo end/p' "$1" | cut -d '|' -f 1-4,6-; }

demo() {
    local folder
    folder=$(mktemp -d)
    cp README.md "$folder/"
    if ran unit; then
        # The command of the tests' build, which checks arithmetic too: a release build of it alone would take minutes.
        built
        "$(program eecvs)" demo -o "$folder/demo" --save "$folder/README.md"
    else
        cargo run --release --quiet -- demo -o "$folder/demo" --save "$folder/README.md"
    fi
    test -s "$folder/demo/report.html" -a -s "$folder/demo/dense.png"
    if ! diff <(demo_table README.md) <(demo_table "$folder/README.md"); then
        echo "the table in README.md differs from that of the demo: run 'eecvs demo --save README.md'"
        return 1
    fi
    rm -r "$folder"
}

# A stage runs in a process of its own, so that its first failing command ends it.
if [ "${1:-}" = --stage ]; then
    "$2"
    exit
fi

stages=("$@") beside=()
if [ ${#stages[@]} = 0 ]; then
    stages=(lint unit) beside=(nostd firmware demo usb python links)
    # Two at a time: compilers leave a core idle for a third of the time. Not where installations would meet.
    have flock || { stages+=("${beside[@]}"); beside=(); }
fi
for stage in "${stages[@]}"; do
    case $stage in
        lint | unit | links | metrics | peers | python | torch | page | ros | nostd | neon | firmware | cores | usb | usb-recordings | fuzz | demo) ;;
        *) echo "test.sh: unknown stage '$stage'; the head of this file lists the stages" >&2; exit 2 ;;
    esac
done

STATE=$(mktemp -d)
SKIPPED=$STATE/skipped INSTALLING=$STATE/installing FAILED=$STATE/failed
STAGES="${stages[*]} ${beside[*]}"
export STATE SKIPPED INSTALLING STAGES
touch "$SKIPPED" "$FAILED"
second=
trap '[ -z "$second" ] || kill -- "-$second" 2>/dev/null || true; rm -rf "$STATE"' EXIT

run() {
    local TIMEFORMAT="=== $1 took %0R s, %0U s of processor time"
    echo "=== $1"
    time "$0" --stage "$1" || echo "$1" >>"$FAILED"
}

# The output of those that run beside others comes in one piece, at their end.
run_beside() {
    local stage
    for stage in "$@"; do
        run "$stage" >"$STATE/$stage.log" 2>&1
        cat "$STATE/$stage.log"
    done
}

if [ ${#beside[@]} -gt 0 ]; then
    # A process group of its own, which ends with this script.
    set -m
    run_beside "${beside[@]}" </dev/null &
    second=$!
    set +m
    # Emulated devices and peers have deadlines: these are in the other lane, and go first.
    renice -n 5 -p $$ >/dev/null 2>&1 || true
fi
for stage in "${stages[@]}"; do
    run "$stage"
done
[ -z "$second" ] || wait "$second"
second=

sed 's/^/skipped: /' "$SKIPPED"
if [ -s "$FAILED" ]; then
    echo "FAILED: $(paste -sd ' ' "$FAILED")"
    exit 1
fi
echo "all stages passed: $STAGES"
