#!/bin/sh
# Installs the wheel into a separate Python environment.
. "$(dirname "$0")/common.sh"
no_rust
packages python3 python3-venv python3-numpy
wheel=$(one "lumistack-*-abi3-manylinux*_$(uname -m).whl")
documented "$wheel"
python3 -m venv --system-site-packages "$HOME/venv"
installs "$HOME/venv/bin/pip" install --no-index --no-deps "$wheel"
tarball
first_job "$HOME/venv/bin/lumistack" "$HOME/.local/share/lumistack/scenes"
"$HOME/venv/bin/python" "$HERE/wheel.py" "$WORK/run"
