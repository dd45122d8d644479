"""`python -m trinoc`, the same as `trinoc`."""

import sys

from trinoc.cli import program

if __name__ == "__main__":
    sys.exit(program.run())
