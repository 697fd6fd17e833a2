# The script that a child process runs by `python -c`. Even an old Python must be able to parse it,
# since the script also reports that a Python is too old.
import sys

sys.path[:] = [place for place in sys.path if place]  # modules in the working folder must not shadow Python's
import json
import os
import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C also ends a call into C++
request = json.loads(sys.stdin.buffer.read().decode("utf-8"))
# The scene package is written to the original standard output. Descriptor 1 now leads to standard
# error, so output of libraries cannot enter the package.
out = os.dup(1)
os.dup2(2, 1)
os.lseek(out, 0, os.SEEK_SET)
os.ftruncate(out, 0)


def fail(kind, message):
    header = json.dumps({"schema": "lumistack.scene-package", "version": 1, "error": {"kind": kind, "message": message}})
    header = header.encode("utf-8")
    with os.fdopen(out, "wb") as package:
        package.write(b"LUMIPKG1" + len(header).to_bytes(8, "little") + header)
    sys.exit(0)


found = "Python %d.%d.%d" % sys.version_info[:3]
if sys.version_info < (3, 8):
    fail("python", found + ", which is older than 3.8")
try:
    from pxr import Usd
except ImportError as error:
    fail("pxr", "%s without OpenUSD (%s)" % (found, error))
if Usd.GetVersion() < (0, 23, 5):
    fail("pxr", "%s with OpenUSD %d.%02d, which is older than 23.05" % ((found,) + Usd.GetVersion()[1:]))

import linecache
import types

package = types.ModuleType("lumistack_usd")
package.__path__ = []
sys.modules["lumistack_usd"] = package
for name, text in request["modules"]:
    module = types.ModuleType("lumistack_usd." + name)
    module.__file__ = "lumistack_usd/" + name + ".py"
    linecache.cache[module.__file__] = (len(text), None, text.splitlines(True), module.__file__)
    sys.modules[module.__name__] = module
    setattr(package, name, module)
    exec(compile(text, module.__file__, "exec"), module.__dict__)
try:
    writer = package.walk.walk(request)
except package.writer.Refused as refused:
    fail("scene", str(refused))
except Exception:
    import traceback

    fail("walker", traceback.format_exc())
with os.fdopen(out, "wb") as package_file:
    writer.write(package_file)
# Exit without destructors: the destructors of a large stage take longer than the work itself.
sys.stderr.flush()
os._exit(0)
