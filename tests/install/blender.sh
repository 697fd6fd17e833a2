#!/bin/sh
# The extension with its wheel, in the module bpy that $BLENDER_PYTHON has: `cargo xtask blender` fetches it.
. "$(dirname "$0")/common.sh"
: "${BLENDER_PYTHON:?names a Python with bpy}"
case $(uname -m) in x86_64) platform=linux_x64 ;; *) platform=linux_arm64 ;; esac
"$BLENDER_PYTHON" "$HERE/../../plugins/blender/tests/cases.py" lifecycle,make "$(one "lumistack-blender-*-$platform.zip")" "$WORK/cases"
