"""The entry of `cmp-cl` and of `python -m cmp_cl`."""

import sys

from cmp_cl.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
