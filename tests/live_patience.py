"""Waiting for another process, which has to start, to import and to answer."""

from __future__ import annotations

from functools import partial

import patience

PATIENCE_S = 180.0  # only a failing test waits this long
eventually = partial(patience.eventually, patience_s=PATIENCE_S)
