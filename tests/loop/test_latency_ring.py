"""The span ring against numpy's percentiles."""

from __future__ import annotations

import json
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.host.calibration import SpeedCalibration
from edge.loop.latency import LatencyRing
from edge.loop.stages import STAGES, TICK_DEADLINE_MS

MS = 1_000_000
REFERENCE = SpeedCalibration("m", 1.0, {})
NAMES = [stage.name for stage in STAGES]
INGEST, DETECT, MAP, LIFT = (NAMES.index(name) for name in ("ingest", "detect", "map", "lift"))


def tick(ring: LatencyRing, spans_ns: dict[int, int], total_ns: int, start_ns: int = 1000) -> None:
    ring.begin_tick(start_ns)
    for stage, duration_ns in spans_ns.items():
        ring.span(stage, duration_ns)
    ring.end_tick(start_ns + total_ns)


def test_empty():
    report = LatencyRing().report()
    assert [row.name for row in report.rows] == [*(s.name for s in STAGES), "tick"]
    assert all(row.n == row.count == 0 and row.verdict == "-" for row in report.rows)
    assert "ingest" in report.table()
    assert json.loads(json.dumps(report.as_dict()))["tick"]["n"] == 0


@given(
    durations=st.lists(st.integers(0, 10**9), min_size=1, max_size=60),
    capacity=st.integers(1, 40),
    last=st.one_of(st.none(), st.integers(1, 80)),
)
def test_percentiles_are_numpys_over_the_newest(durations, capacity, last):
    ring = LatencyRing(capacity)
    for duration in durations:
        tick(ring, {MAP: duration}, duration)
        ring.span(DETECT, duration)
    window = np.array(durations[-min(capacity, last or capacity) :]) / MS
    report = ring.report(last)
    for row in (report.stage("map"), report.stage("detect"), report.tick):
        expected = [*np.percentile(window, [50, 95, 99]), window.max()]
        np.testing.assert_allclose(
            [row.p50_ms, row.p95_ms, row.p99_ms, row.max_ms], expected, rtol=1e-12, atol=1e-12
        )
        assert (row.n, row.count) == (len(window), len(durations))


@pytest.mark.parametrize(
    ("slowdown", "map_ms", "tick_ms", "says"),
    [
        (1.0, 1.5, 3.0, "as fast as the reference computer"),
        (2.0, 3.0, 6.0, "2.0 times slower than the reference computer"),
        (20.0, 30.0, TICK_DEADLINE_MS, "20.0 times slower"),
    ],
)
def test_budgets_grow_with_a_slower_computer_and_deadlines_do_not(slowdown, map_ms, tick_ms, says):
    ring = LatencyRing(calibration=SpeedCalibration("m", slowdown, {}))
    tick(ring, {MAP: round(1.6 * MS)}, 2 * MS)
    report = ring.report()
    found = report.stage("map")
    assert (found.budget_ms, report.tick.budget_ms) == (map_ms, tick_ms)
    assert (found.verdict, found.overruns) == (("over", 1) if slowdown == 1.0 else ("ok", 0))
    assert report.stage("detect").budget_ms == STAGES[DETECT].budget_ms
    assert report.deadline_ms == TICK_DEADLINE_MS
    assert says in report.table().splitlines()[-1]
    assert report.as_dict()["slowdown"] == slowdown


def test_without_a_calibration_only_deadlines_are_reported():
    """A first run that met every deadline must not end in rows that say `over`."""
    ring = LatencyRing()
    for _ in range(3):
        ring.span(DETECT, round(1.1 * TICK_DEADLINE_MS * MS))
        tick(ring, {MAP: 20 * MS, LIFT: 5 * MS}, 32 * MS)
    report = ring.report()
    verdicts = {row.name: row.verdict for row in report.rows if row.verdict != "-"}
    assert verdicts == {"detect": "over", "tick": "ok"}
    assert (report.stage("map").budget_ms, report.stage("map").overruns) == (None, 0)
    assert report.tick.budget_ms == report.deadline_ms == TICK_DEADLINE_MS
    summary = report.as_dict()
    assert (summary["slowdown"], summary["stages"]["map"]["budget_ms"]) == (None, None)
    *table, hint = report.table().splitlines()
    assert "edge bench --calibrate" in hint
    assert "deadline" in table[0]
    assert "budget" not in "".join(table)


def test_an_abandoned_tick_counts_only_as_a_drop():
    ring = LatencyRing()
    ring.set_drops(MAP, 2)
    ring.begin_tick(1_000)
    ring.mark(INGEST, 9_000)
    ring.abandon_tick(MAP)
    tick(ring, {MAP: 5 * MS}, 5 * MS)
    report = ring.report()
    assert (report.stage("map").drops, report.tick.drops) == (3, 3)
    assert (report.tick.count, report.stage("ingest").n, report.tick.max_ms) == (1, 0, 5.0)


def test_marks_share_the_time_of_a_tick_out():
    ring = LatencyRing()
    ring.begin_tick(1_000)
    ring.mark(INGEST, 1_400)
    ring.mark(MAP, 2_000)
    ring.mark(LIFT, 2_100)
    ring.mark(MAP, 2_900)
    ring.end_tick(3_000)
    report = ring.report()
    measured = {row.name: round(row.max_ms * MS) for row in report.rows if row.n}
    assert measured == {"ingest": 400, "map": 1_400, "lift": 100, "tick": 2_000}


def test_the_table_is_aligned_and_marks_exceeded_budgets():
    ring = LatencyRing(calibration=REFERENCE)
    tick(ring, {INGEST: 100, MAP: 2 * MS, LIFT: 123_456_789}, 200 * MS)
    lines = ring.report().table().splitlines()
    header, rows = lines[0], [line for line in lines[1:-2] if not line.startswith("-")]
    end = header.index("p99") + 3
    assert all(line[end] == " " and line[end - 1] in "0123456789-" for line in rows)
    verdicts = {line.split()[0]: line.split()[-1] for line in rows}
    assert verdicts["map"] == verdicts["lift"] == verdicts["tick"] == "over"
    assert (verdicts["ingest"], verdicts["plan"]) == ("ok", "-")


def test_unknown_stage_and_capacity():
    with pytest.raises(KeyError):
        LatencyRing().report().stage("nope")
    with pytest.raises(ValueError, match="capacity"):
        LatencyRing(0)


def test_a_tick_allocates_nothing_that_stays():
    ring = LatencyRing()
    stages = [i for i, stage in enumerate(STAGES) if stage.in_tick]

    def one_tick() -> None:
        ring.begin_tick(10**15)
        for i in stages:
            ring.mark(i, 10**15 + i * MS)
        ring.end_tick(10**15 + 9 * MS)

    def taken() -> tuple[int, int]:
        """Bytes that stay after 500 ticks, and the most that there were."""
        one_tick()
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(500):
            one_tick()
        after, peak = tracemalloc.get_traced_memory()
        return after - before, peak - before

    tracemalloc.start()
    try:
        # The least of some: threads of other tests may just be ending.
        stays, peak = map(min, zip(*(taken() for _ in range(5)), strict=True))
    finally:
        tracemalloc.stop()
    assert stays < 500  # less than a byte a tick
    assert peak < 2000  # the integers of one tick


@given(
    durations=st.lists(st.integers(0, 10**9), min_size=1, max_size=60), capacity=st.integers(1, 40)
)
def test_histograms_count_all_ticks_since_the_start(durations, capacity):
    ring = LatencyRing(capacity)
    for i, duration in enumerate(durations):
        tick(ring, {MAP: duration}, duration, start_ns=i * 10**8)
        ring.span(DETECT, duration)
    found = ring.histograms()
    for h in (found.stages["map"], found.stages["detect"], found.tick):
        assert sum(h.counts) == len(durations)
        assert h.sum_s == pytest.approx(sum(durations) * 1e-9)
    assert sum(found.stages["score"].counts) == 0
    assert sum(found.interval.counts) == len(durations) - 1
    assert found.interval.sum_s == pytest.approx((len(durations) - 1) * 0.1)


def test_spans_are_listed_in_order():
    ring = LatencyRing(capacity=2)
    for k in range(3):
        begin_ns = 1000 * k
        ring.begin_tick(begin_ns)
        ring.mark(INGEST, begin_ns + 100)
        ring.mark(MAP, begin_ns + 300)
        ring.span(DETECT, 250)
        ring.mark(LIFT, begin_ns + 350)
        ring.end_tick(begin_ns + 400)
    expected = [
        ("tick", 0, 400, True), ("ingest", 0, 100, True), ("map", 100, 200, True),
        ("lift", 300, 50, True),
    ]  # fmt: skip
    newest = [(name, at + 2000, took, inside) for name, at, took, inside in expected]
    older = [(name, at + 1000, took, inside) for name, at, took, inside in expected]
    other_thread = [("detect", 1300 - 250, 250, False), ("detect", 2300 - 250, 250, False)]
    assert ring.spans() == older + newest + other_thread
    assert ring.spans(after_ns=1300) == newest + other_thread[1:]
