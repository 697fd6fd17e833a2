#!/bin/sh
# On a clean Debian, installs the extension (which contains the wheel) with Blender's own command.
# Then runs the operator of the extension's button (press.py), and its command `lumistack make`. On
# a machine that is not clean, this script uses the module bpy of $BLENDER_PYTHON, which `cargo
# xtask blender` fetches.
. "$(dirname "$0")/common.sh"
case $(uname -m) in x86_64) platform=linux_x64 ;; *) platform=linux_arm64 ;; esac
zip=$(one "lumistack-blender-*-$platform.zip")
documented "$zip"
if [ -n "${CLEAN:-}" ]; then
    no_rust
    packages blender python3-numpy
    blender --version | head -n 1
    installs blender --command extension install-file --repo user_default --enable "$zip"
    blender --background --python-exit-code 1 --python "$HERE/press.py" -- "$WORK"
    blender --background "$WORK/shot.blend" --command lumistack make --display "$WORK/display.toml" --iterations 1 --samples 1 --renderer lumistack -o "$WORK/command"
    [ -s "$WORK/command/layers/stack.json" ]
else
    : "${BLENDER_PYTHON:?must name a Python with bpy}"
    "$BLENDER_PYTHON" "$HERE/../../plugins/blender/tests/cases.py" lifecycle,make "$zip" "$WORK/cases"
fi
