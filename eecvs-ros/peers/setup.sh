#!/usr/bin/env bash
# Makes an environment with genuine ROS 2 peers, for tests alone: setup.sh FOLDER
#
#   FOLDER/venv         Python with rclpy of ROS 2 Kilted, its Fast DDS middleware and messages, Zenoh, readers
#                       of bags; built here with Kilted's rosidl: event_camera_msgs and eecvs_msgs
#   FOLDER/hashes.txt   `hash TYPE HASH` of every message and service, as type descriptions have them
#
# env.sh runs a command in it. The wheels are third-party builds, for Python 3.10 to 3.13. Ends at once if FOLDER is
# complete. Exit status 77: something is missing that cannot be installed here. Log: FOLDER/log.
set -euo pipefail
[ $# = 1 ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
caller=$PWD
cd "$(dirname "$0")"
# shellcheck source=/dev/null
. ./common.sh
folder=$(cd "$caller" && absolute "$1")
venv=$folder/venv
messages=("$PWD/event_camera_msgs" "$(cd ../../eecvs_msgs && pwd)")

# The wheels pin each other to a minor version; those with no name of ROS 2 are not pinned by them.
wheels=(
    ros-kilted-rclpy==9.1.2
    ros-kilted-rmw-fastrtps-cpp==9.3.3
    ros-kilted-std-msgs==5.5.1
    ros-kilted-sensor-msgs==5.5.1
    ros-kilted-diagnostic-msgs==5.5.1
    ros-kilted-ament-package==0.17.2
    ros-kilted-ament-cmake==2.7.3
    ros-kilted-ament-cmake-include-directories==2.7.3
    ros-kilted-ament-cmake-ros-core==0.14.5
    ros-kilted-rosidl-core-generators==0.3.1
    ros-kilted-rosidl-default-generators==1.7.1
    catkin-pkg==1.1.1 empy==3.3.4 lark-parser==0.12.0 numpy==2.2.6
    eclipse-zenoh==1.10.2 mcap==1.6.0 mcap-ros2-support==0.6.0 rosbags==0.11.9 zenoh-ros2-sdk==0.1.8
)
# A layout that became another would show here first.
expected="hash event_camera_msgs/msg/EventPacket RIHS01_d6fa176260b1f37e5a40845305315e150a0f18191241eb64f407442aa29844aa"

have python3 || packages python3 || missing "there is no python3 and apt-get cannot install it"
python3 -c 'import sys; sys.exit(not (3, 10) <= sys.version_info < (3, 14))' ||
    missing "rclpy's wheels need Python 3.10 to 3.13, and this is $(python3 --version)"

alone "$folder"
stamp=$(checksum setup.sh common.sh "${messages[@]}" <<<"$folder $(python3 -c 'import sys; print(sys.version, sys.base_prefix)')")
[ "$stamp" != "$(cat "$folder/stamp" 2>/dev/null)" ] || exit 0
rm -rf "${folder:?}/stamp" "${folder:?}/venv" "${folder:?}/build"

python3 -m venv "$venv" >"$folder/log" 2>&1 ||
    { packages python3-venv && python3 -m venv --clear "$venv" >"$folder/log" 2>&1; } ||
    missing "python3 cannot create a virtual environment: see $folder/log"
"$venv/bin/pip" install --disable-pip-version-check "${wheels[@]}" >>"$folder/log" 2>&1 ||
    missing "pip cannot install the ROS 2 packages: see $folder/log"

headers=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
[ -e "$headers/Python.h" ] || { packages python3-dev && [ -e "$headers/Python.h" ]; } ||
    missing "the headers of Python are missing in $headers"
for tool in cmake make g++; do
    have "$tool" || packages "$tool" || missing "there is no $tool and apt-get cannot install it"
done

# The wheels name the folders of the interpreter that they were built with.
site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
sed -Ei "s#/opt/python/[^/;\"]+/lib/python[0-9.]+/site-packages#$site#g; s#/opt/python/[^/;\"]+/include/python[0-9.]+#$headers#g" \
    "$venv"/share/*/cmake/*rosidl_generator_py*Export*.cmake

# One package of messages, into the environment.
build() (
    unset PYTHONHOME PYTHONPATH
    export PATH=$venv/bin:$PATH AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
    tree=$folder/build/$(basename "$1")
    cmake -S "$1" -B "$tree" -DCMAKE_INSTALL_PREFIX="$venv" -DPython3_EXECUTABLE="$venv/bin/python" \
        -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release &&
        cmake --build "$tree" -j "$(nproc)" && cmake --install "$tree"
)
for package in "${messages[@]}"; do
    build "$package" >>"$folder/log" 2>&1 || failed "$package cannot be built: see $folder/log"
done

"$venv/bin/python" - "$venv/share" >"$folder/hashes.txt" <<'PYTHON'
import json, pathlib, sys
share = pathlib.Path(sys.argv[1])
hashes = {}
for path in sorted([*share.glob("*/msg/*.json"), *share.glob("*/srv/*.json")]):
    for each in json.loads(path.read_text())["type_hashes"]:
        hashes[each["type_name"]] = each["hash_string"]
for name in sorted(hashes):
    print("hash", name, hashes[name])
PYTHON
grep -qx "$expected" "$folder/hashes.txt" ||
    failed "the hash of EventPacket differs from the expected one: see $folder/hashes.txt"
rm -rf "${folder:?}/build"
echo "$stamp" >"$folder/stamp"
