#!/usr/bin/env bash
# Runs a command in the environment that setup.sh has made: env.sh FOLDER COMMAND...
#
#   eecvs-ros/peers/setup.sh target/ros
#   ROS_DOMAIN_ID=42 eecvs-ros/peers/env.sh target/ros python eecvs-ros/peers/rclpy_peer.py graph --seconds 5
#
# ROS_DOMAIN_ID is the caller's. Peers find each other on this host alone.
set -euo pipefail
[ $# -ge 2 ] || { sed -n '2,7s/^# \{0,1\}//p' "$0" >&2; exit 2; }
venv=$(cd "$1/venv" && pwd)
shift
libraries=$venv/lib
for each in "$venv"/lib/python3.*/site-packages/ros_*.libs; do
    libraries+=:$each
done
unset PYTHONHOME PYTHONPATH
export PATH=$venv/bin:$PATH LD_LIBRARY_PATH=$libraries AMENT_PREFIX_PATH=$venv _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
export ROS_DISTRO=kilted RMW_IMPLEMENTATION=rmw_fastrtps_cpp ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
export ROS_LOG_DIR=$venv/log
exec "$@"
