#!/bin/sh
# Installs the wheel into a separate Python environment.
. "$(dirname "$0")/common.sh"
no_rust
packages python3 python3-venv python3-numpy
wheel=$(one "lumistack-*-manylinux*_$(uname -m).whl")
documented "$wheel"
python3 -m venv --system-site-packages "$HOME/venv"
installs "$HOME/venv/bin/pip" install --no-index --no-deps "$wheel"
tarball
first_job "$HOME/venv/bin/lumistack" "$HOME/.local/share/lumistack/scenes"
"$HOME/venv/bin/python" - "$WORK/run" <<'PYTHON'
import sys

import lumistack
import numpy

print(lumistack.__version__, lumistack.defaults()["render"]["zone_samples"])
stack = lumistack.LayerStack.open(sys.argv[1])
picture = numpy.asarray(stack.simulate((0.05, 0.0)))
assert picture.shape[2] == 3 and picture.std() > 0.01, picture
print(stack, picture.shape, "numpy", numpy.__version__)
PYTHON
