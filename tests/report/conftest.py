"""Runs to report on; see `report_runs`."""

from __future__ import annotations

import pytest
from report_runs import flat_run, mission_run
from simulated import simulated

from edge.loop.latency import LatencyRing
from edge.report.record import RunRecord
from edge.report.recorder import Recorder
from edge.types import MissionStatus


@pytest.fixture(scope="session")
def long_run() -> RunRecord:
    return mission_run()


@pytest.fixture(scope="session")
def run() -> RunRecord:
    return flat_run()


@pytest.fixture(scope="session")
def empty_run() -> RunRecord:
    """A run that ended before anything arrived."""
    return Recorder(simulated()).finish(MissionStatus("chair", "searching"), LatencyRing().report())
