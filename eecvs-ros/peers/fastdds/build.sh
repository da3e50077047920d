#!/usr/bin/env bash
# Builds a peer of Fast DDS 2 (the system's packages: 2.9.1 of Debian 12) as FOLDER/fastdds_peer: build.sh FOLDER
#
#   ROS_DOMAIN_ID=42 FOLDER/fastdds_peer listen event_camera_msgs/msg/EventPacket /events --count 200 --seconds 20
#
# ../peer.h has the arguments. Ends at once if it is already built. Exit status 77: something is missing that cannot
# be installed here.
set -euo pipefail
[ $# = 1 ] || { sed -n '2,7s/^# \{0,1\}//p' "$0" >&2; exit 2; }
caller=$PWD
cd "$(dirname "$0")"
# shellcheck source=/dev/null
. ../common.sh
folder=$(cd "$caller" && absolute "$1")
exec 9>"$folder/fastdds_peer.lock"
! have flock || flock 9
stamp=$(checksum . ../messages.idl ../peer.h <<<"fastdds")
# Without arguments it tells how it is called, where its libraries are there.
if [ "$stamp" = "$(cat "$folder/fastdds_peer.stamp" 2>/dev/null)" ]; then
    status=0
    "$folder/fastdds_peer" >/dev/null 2>&1 || status=$?
    [ "$status" != 2 ] || exit 0
fi
rm -f "$folder/fastdds_peer.stamp"

if ! have g++ || ! have fastddsgen || ! [ -e /usr/include/fastdds ]; then
    packages g++ fastddsgen libfastrtps-dev libfastcdr-dev || missing "apt-get cannot install Fast DDS"
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
{
    fastddsgen -replace -d "$work" ../messages.idl &&
        g++ -O1 -std=c++17 -Wall -Wextra -Wno-unused-parameter -I"$work" peer.cpp "$work"/*.cxx -lfastrtps -lfastcdr -o "$folder/fastdds_peer"
} >"$folder/fastdds_peer.log" 2>&1 || failed "the Fast DDS peer cannot be built: see $folder/fastdds_peer.log"
echo "$stamp" >"$folder/fastdds_peer.stamp"
