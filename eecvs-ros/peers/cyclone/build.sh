#!/usr/bin/env bash
# Builds a peer of Cyclone DDS (the system's packages: 0.10.2 of Debian 12) as FOLDER/cyclone_peer: build.sh FOLDER
#
#   ROS_DOMAIN_ID=42 FOLDER/cyclone_peer listen event_camera_msgs/msg/EventPacket /events --count 200 --seconds 20
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
exec 9>"$folder/cyclone_peer.lock"
! have flock || flock 9
stamp=$(checksum . ../messages.idl ../peer.h <<<"cyclone")
# Without arguments it tells how it is called, where its libraries are there.
if [ "$stamp" = "$(cat "$folder/cyclone_peer.stamp" 2>/dev/null)" ]; then
    status=0
    "$folder/cyclone_peer" >/dev/null 2>&1 || status=$?
    [ "$status" != 2 ] || exit 0
fi
rm -f "$folder/cyclone_peer.stamp"

if ! have gcc || ! have idlc || ! [ -e /usr/include/dds/dds.h ]; then
    packages gcc cyclonedds-dev cyclonedds-tools || missing "apt-get cannot install Cyclone DDS"
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
{
    idl=$PWD/../messages.idl &&
        (cd "$work" && idlc -x final "$idl") &&
        gcc -O1 -std=c11 -Wall -Wextra -I"$work" peer.c "$work/messages.c" -lddsc -o "$folder/cyclone_peer"
} >"$folder/cyclone_peer.log" 2>&1 || failed "the Cyclone DDS peer cannot be built: see $folder/cyclone_peer.log"
echo "$stamp" >"$folder/cyclone_peer.stamp"
