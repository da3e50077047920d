#!/usr/bin/env bash
# Writes the golden vectors of this folder: cdr/write.sh FOLDER, which setup.sh has filled.
set -euo pipefail
folder=$(cd "$1" && pwd)
cd "$(dirname "$0")"
for type in event_camera_msgs/EventPacket eecvs_msgs/{Frame,Density,Volume} sensor_msgs/{Image,CameraInfo} \
    diagnostic_msgs/DiagnosticArray; do
    ../env.sh "$folder" python ../rclpy_peer.py cdr "${type%/*}/msg/${type#*/}" >"${type#*/}.json"
done
