#!/usr/bin/env bash
# Runs a command in the environment that setup.sh has made: env.sh FOLDER COMMAND...
# It stays on this computer, in the domain ROS_DOMAIN_ID.
set -euo pipefail
folder=$(cd "$1" && pwd)
shift
export PATH=$folder/python/bin:$PATH
export AMENT_PREFIX_PATH=$folder/install:$folder/python
export PYTHONPATH=$folder/install/lib/python3.11/site-packages
export LD_LIBRARY_PATH=$folder/install/lib:$folder/python/lib
export RMW_IMPLEMENTATION=rmw_fastrtps_cpp ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
exec "$@"
