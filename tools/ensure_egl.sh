#!/usr/bin/env bash
# MuJoCo draws off-screen through EGL. Where its libraries are missing: install them if this is root on a Debian-like
# system, else say what to do. Another MUJOCO_GL, or another system than Linux, is the caller's own choice.
set -euo pipefail

[[ $(uname -s) == Linux && ${MUJOCO_GL:-egl} == egl ]] || exit 0

packages=(libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri libopengl0)

have_egl() {
  # The dispatcher, and at least one driver behind it.
  local cache
  cache=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p)
  [[ $cache == *libEGL.so.1* && ($cache == *libEGL_mesa.so.0* || $cache == *libEGL_nvidia.so.0*) ]]
}

have_egl && exit 0

if [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
  echo "EGL is missing; installing ${packages[*]}" >&2
  export DEBIAN_FRONTEND=noninteractive
  apt-get update -qq
  apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
  have_egl && exit 0
fi

cat >&2 <<MESSAGE
Off-screen rendering needs EGL, and its libraries were not found.
  Debian, Ubuntu:  sudo apt-get install ${packages[*]}
  otherwise:       your system's package of Mesa's EGL
  or choose another of MuJoCo's backends, which skips this check:  MUJOCO_GL=glfw  (a screen)  or  MUJOCO_GL=osmesa
MESSAGE
exit 1
