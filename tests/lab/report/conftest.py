"""Runs to report on; see `report_runs`."""

from __future__ import annotations

from dataclasses import replace

import pytest
from report_runs import flat_run, mission_run
from results import result
from simulated import simulated

from edge.lab.report.record import RunRecord
from edge.lab.report.recorder import ReportRecorder


@pytest.fixture(scope="session")
def long_run() -> RunRecord:
    return mission_run()


@pytest.fixture(scope="session")
def run() -> RunRecord:
    return flat_run()


@pytest.fixture(scope="session")
def empty_run() -> RunRecord:
    """Return a run that ended before any message."""
    record = ReportRecorder(simulated()).record(result(), {})
    return replace(record, map=None, mission_facts=None)
