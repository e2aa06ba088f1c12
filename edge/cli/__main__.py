"""`python -m edge.cli` is the `edge` command."""

import sys

from edge.cli.main import main

sys.exit(main())
