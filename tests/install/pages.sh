#!/bin/sh
# Runs every command of the documentation's first pages, with the program of the tarball and the
# package of the wheel.
. "$(dirname "$0")/common.sh"
packages python3 python3-venv python3-numpy
tarball
if [ -x "$HERE/../../target/python/bin/python" ]; then python="$HERE/../../target/python/bin/python"; else python=python3; fi
"$python" -m venv --system-site-packages "$HOME/venv"
installs "$HOME/venv/bin/pip" install --quiet --no-index --no-deps "$(one "lumistack-*-abi3-manylinux*_$(uname -m).whl")"
[ -n "${CLEAN:-}" ] || "$HOME/venv/bin/pip" install --quiet numpy
PATH="$HOME/.local/bin:$PATH" "$HOME/venv/bin/python" "$HERE/pages.py" "$WORK"
