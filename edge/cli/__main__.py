"""`python -m edge.cli`: the same as the command `edge`."""

import sys

from edge.cli.main import main

sys.exit(main())
