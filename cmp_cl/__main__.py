"""`python -m cmp_cl` is `cmp-cl`."""

import sys

from cmp_cl.cli.starting import main

sys.exit(main())
