"""Times of day on the clock of a time zone, and the end of a wait."""

from __future__ import annotations

import time
from datetime import datetime, timezone

import pytest

from edge.config import MissionConfig
from edge.geometry import SE2
from edge.loop.input_log import InputLog
from edge.loop.mission_control import MissionControl
from edge.mission.checkpoint import restore, state_of
from edge.mission.run import MissionRun
from edge.mission.spec import prepare
from edge.mission.time_of_day import next_ns

S = 1_000_000_000


@pytest.fixture
def zone(monkeypatch, request):
    monkeypatch.setenv("TZ", request.param)
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def utc_ns(text: str) -> int:
    moment = datetime.strptime(text, "%Y-%m-%d %H:%M:%S").replace(tzinfo=timezone.utc)
    return int(moment.timestamp()) * S


@pytest.mark.parametrize("zone", ["CET-1CEST,M3.5.0,M10.5.0/3"], indirect=True)
@pytest.mark.parametrize(
    ("time_of_day", "after", "comes"),
    [
        ("09:00", "2026-07-01 06:59:59", "2026-07-01 07:00:00"),
        ("09:00", "2026-07-01 07:00:00", "2026-07-02 07:00:00"),
        ("00:00", "2026-07-01 06:00:00", "2026-07-01 22:00:00"),
        ("23:59", "2026-12-31 23:00:00", "2027-01-01 22:59:00"),
        # The clock goes from 02:00 to 03:00, so that a day has 23 hours.
        ("09:00", "2026-03-28 08:00:00", "2026-03-29 07:00:00"),
        ("02:30", "2026-03-28 23:00:00", "2026-03-29 01:30:00"),
        # The clock goes from 03:00 back to 02:00, so that a day has 25 hours.
        ("09:00", "2026-10-24 07:00:00", "2026-10-25 08:00:00"),
        ("02:30", "2026-10-24 22:00:00", "2026-10-25 00:30:00"),
        ("02:30", "2026-10-25 00:30:00", "2026-10-26 01:30:00"),
        ("02:30", "2026-10-25 01:15:00", "2026-10-25 01:30:00"),
    ],
)
@pytest.mark.usefixtures("zone")
def test_a_time_of_day_comes_when_the_clock_shows_it(time_of_day, after, comes):
    assert next_ns(time_of_day, utc_ns(after)) == utc_ns(comes)


def begun(formula: str) -> MissionRun:
    mission = MissionRun(prepare(MissionConfig(), formula=formula), MissionConfig())
    mission.start(0)
    return mission


def test_a_wait_ends_at_the_same_time_after_a_restart():
    formula, begin_ns = 'F "wait until 09:00"', utc_ns("2026-07-01 12:00:00")
    mission = begun(formula)
    ends_ns = mission.meter.end_of_wait_ns(mission.target, "09:00", begin_ns)
    again = begun(formula)
    restore(again, state_of(mission, "waiting"))
    later_ns = ends_ns + 3600 * S  # the service was off at 09:00
    assert again.meter.end_of_wait_ns(again.target, "09:00", later_ns) == ends_ns
    # A simulation that begins again at 1970 counts from there.
    assert again.meter.end_of_wait_ns(again.target, "09:00", S) == next_ns("09:00", S)


def test_the_limits_do_not_apply_to_a_wait_until_a_time_of_day():
    mission = begun('F "wait until 09:00"')
    for t_s in range(0, 80_000, 20_000):
        mission.observe(SE2(0, 0, 0), t_s * S)
        mission.check_limits(t_s * S)
    assert not mission.done


def test_each_wait_until_a_time_of_day_is_counted_from_its_begin():
    mission, begin_ns = begun('F "wait until 09:00"'), utc_ns("2026-07-01 12:00:00")
    ends_ns = mission.meter.end_of_wait_ns(mission.target, "09:00", begin_ns)
    assert mission.meter.end_of_wait_ns(mission.target, "09:00", ends_ns) == ends_ns
    mission.meter.end_pursuit(mission.target)
    assert mission.meter.end_of_wait_ns(mission.target, "09:00", ends_ns) == next_ns(
        "09:00", ends_ns
    )


def test_the_end_is_a_decision_that_a_replay_repeats():
    """The computer that replays may have another time zone."""
    noted = InputLog()
    control = MissionControl(
        begun('F "wait until 09:00"').spec, MissionConfig(), None, noted, lambda *_: None
    )
    ends_ns = control.mission.meter.end_of_wait_ns("wait until 09:00", "09:00", S)
    (entry,) = noted.pending
    assert (entry.kind, entry.fields["name"]) == ("decision", "wait")
    control.mission.meter.begin_round()
    control.mission.meter.decide = lambda what, decide: "7"
    assert ends_ns > control.mission.meter.end_of_wait_ns("wait until 09:00", "09:00", S) == 7
