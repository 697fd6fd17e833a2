#!/bin/sh
# Every command of the documentation's first pages, with the program of the tarball and the Python of the wheel.
. "$(dirname "$0")/common.sh"
mkdir -p "$HOME/.local"
tar xzf "$(one "lumistack-*-$(uname -m)-unknown-linux-gnu.tar.gz")" -C "$HOME/.local" --strip-components=1
if [ -x "$HERE/../../target/python/bin/python" ]; then python="$HERE/../../target/python/bin/python"; else python=python3; fi
"$python" -m venv --system-site-packages "$HOME/venv"
"$HOME/venv/bin/pip" install --quiet --no-index --no-deps "$(one "lumistack-*-manylinux*_$(uname -m).whl")"
"$HOME/venv/bin/pip" install --quiet numpy
PATH="$HOME/.local/bin:$PATH" "$HOME/venv/bin/python" "$HERE/pages.py" "$WORK"
