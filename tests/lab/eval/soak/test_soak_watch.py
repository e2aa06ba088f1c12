"""What the soak reads of the service's pages."""

from __future__ import annotations

import pytest

from edge.lab.eval.soak.watch import dropped

PAGE = """# HELP edge_source_dropped_total Messages that became part of no observation, by reason.
# TYPE edge_source_dropped_total counter
edge_source_dropped_total{reason="stale"} 3.0
edge_source_dropped_total{reason="no_pose"} 0.0
# TYPE edge_stage_dropped_total counter
edge_stage_dropped_total{stage="ingest"} 9.0
"""


@pytest.mark.parametrize(("page", "by_reason"), [("", {}), (PAGE, {"stale": 3})])
def test_drops_are_those_that_there_were_by_reason(page, by_reason):
    assert dropped(page) == by_reason
