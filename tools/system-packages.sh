#!/usr/bin/env bash
# Debian packages for the tests: software OpenGL (the simulator's renderer), ROS 1 and network namespaces (what we send is
# received by other people's programs), Gazebo's own readers of world files and meshes. Without root or apt the tests that
# need them skip by name.
set -euo pipefail
packages=(
  libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri libosmesa6
  python3-roslaunch python3-rospy python3-tf2-ros python3-sensor-msgs python3-rosbag iproute2
  libsdformat12-12 libsdformat-dev libignition-common-dev libxml2-utils g++ pkg-config
)
missing=()
for package in "${packages[@]}"; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
[ ${#missing[@]} -eq 0 ] && exit 0
if [ "$(id -u)" -ne 0 ] || ! command -v apt-get >/dev/null; then
  echo "not installed: ${missing[*]} (needs root and apt); tests that render, talk to ROS 1 or ask Gazebo will be skipped" >&2
  exit 0
fi
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
