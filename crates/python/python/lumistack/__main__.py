"""The command `lumistack`, and `python -m lumistack`."""

import sys
from pathlib import Path

from lumistack import main as run


def main() -> int:
    started = sys.argv[0]
    # With `python -m`, argv[0] is this file.
    is_module = Path(started).name == "__main__.py"
    return run(sys.argv[1:], f"{Path(sys.executable).name} -m lumistack" if is_module else started)


if __name__ == "__main__":
    sys.exit(main())
