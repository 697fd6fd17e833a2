"""The command `lumistack`, and `python -m lumistack`."""

import sys

from lumistack import main as run


def main() -> int:
    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
