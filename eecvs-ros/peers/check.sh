#!/usr/bin/env bash
# Whether the peers understand each other: check.sh FOLDER
#
# Builds them in FOLDER, then sends 200 messages of 50 kB between pairs of them, each pair in a domain of its own from
# ROS_DOMAIN_ID (150 by default) on. All must arrive, in order and with the same content. Exit status 77: something is
# missing that cannot be installed here. Cyclone DDS is on its own: see cyclone/peer.c; Fast DDS of fastdds/ and it do
# not find each other.
set -euo pipefail
[ $# = 1 ] || { sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
for each in setup.sh fastdds/build.sh cyclone/build.sh; do
    "$here/$each" "$1"
done
domain=${ROS_DOMAIN_ID:-150}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
folder=$1

# peer NAME ARGUMENT...
peer() {
    local command=("$folder/$1_peer")
    [ "$1" != rclpy ] || command=("$here/env.sh" "$folder" python "$here/rclpy_peer.py")
    shift
    "${command[@]}" "$@"
}

# The messages that a peer has told of.
messages() { grep -o '"message": .*' "$1"; }

# pair TALKER LISTENER TYPE
pair() {
    local listening
    export ROS_DOMAIN_ID=$((domain++))
    peer "$2" listen "$3" /events --count 200 --seconds 40 >"$work/received" &
    listening=$!
    peer "$1" talk "$3" /events --count 200 --rate 100 --bytes 50000 >"$work/sent" || { wait; return 1; }
    wait "$listening"
    cmp <(messages "$work/sent") <(messages "$work/received")
    echo "$1 to $2: $3: $(grep -c '"received": [0-9]*, "time_ns"' "$work/received") messages"
}

for type in event_camera_msgs/msg/EventPacket eecvs_msgs/msg/Frame; do
    pair rclpy rclpy "$type"
    pair fastdds rclpy "$type"
    pair rclpy fastdds "$type"
    pair cyclone cyclone "$type"
done
for type in eecvs_msgs/msg/{Density,Volume} sensor_msgs/msg/Image diagnostic_msgs/msg/DiagnosticArray; do
    pair rclpy rclpy "$type"
done
