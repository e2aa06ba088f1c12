"""The two stretches that `edge bench --swap` puts side by side."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace

import pytest
from simulated import simulated

from edge.errors import UserError
from edge.lab.bench import swap as swap_bench
from edge.loop.latency import LatencyRing

MS = 1_000_000


@pytest.fixture
def bench(monkeypatch):
    """Return a bench of 2 s on a loop whose clock, counters and swap the test moves."""
    clock = SimpleNamespace(now_ns=10**9)
    monkeypatch.setattr(swap_bench, "time", SimpleNamespace(monotonic_ns=lambda: clock.now_ns))
    monkeypatch.setattr(
        "edge.perception.runtime.cards.load_detector_card", lambda name: SimpleNamespace(name=name)
    )
    asked: list = []
    swapper = SimpleNamespace(state="idle", request=lambda *args: asked.append(args), asked=asked)
    swapper.status = lambda: {
        "state": swapper.state, "model": "new", "previous": "old", "detail": "fine",
    }  # fmt: skip
    running = SimpleNamespace(
        config=simulated({"loop": {"hz": 100.0}}),
        source=SimpleNamespace(counters=Counter(observations=0, superseded=0)),
        worker=SimpleNamespace(stats=SimpleNamespace(done=0)),
        service=SimpleNamespace(detector_swap=swapper, latency=LatencyRing(64)),
    )
    bench = swap_bench.SwapBench(running, "new", 2.0)

    def after(after_ms: float, tick_ms: float = 1.0) -> None:
        clock.now_ns += int(after_ms * MS)
        running.source.counters["observations"] += 1
        running.service.latency.begin_tick(0)
        running.service.latency.end_tick(int(tick_ms * MS))
        bench.after_iteration()

    bench.after, bench.swapper, bench.running = after, swapper, running
    return bench


def test_no_swap_is_requested_before_the_first_detection(bench):
    bench.after_iteration()
    assert bench.swapper.asked == []
    with pytest.raises(
        UserError, match=r"the swap to new was not complete at the end .state: idle.; give a larger"
    ):
        bench.figures()


def test_losses_are_reported_by_stretch(bench):
    bench.after(0)
    bench.after(10)
    bench.after(990)  # 98 beats late, and halfway
    assert bench.swapper.asked == [("new", False, 2 * 10**9)]
    bench.swapper.state = "loading"
    bench.after(10)
    bench.after(19)  # late, but no whole period
    bench.running.source.counters["superseded"] += 3
    bench.running.worker.stats.done += 2
    bench.after(35, tick_ms=7.0)
    bench.swapper.state = "kept"
    bench.after(10)
    bench.after(500)
    figures = bench.figures()
    before, during = figures["before"], figures["during"]
    assert (before["lost"], before["ticks"], before["let_go"]) == (98, 2, 0)
    assert (during["lost"], during["ticks"], during["let_go"], during["images"]) == (2, 4, 3, 2)
    assert during["longest_ms"] == pytest.approx(35)
    assert (during["max_ms"], before["max_ms"]) == (7.0, 1.0)
    text = swap_bench.table(figures)
    assert text.splitlines()[0] == "swap of old to new: kept: fine"
    assert "ticks lost                      98           2" in text


@pytest.mark.parametrize(
    ("state", "lost", "over"),
    [
        ("kept", 0, []),
        ("kept", 2, ["ticks lost by the swap"]),
        ("rolled back", 0, ["swaps given up"]),
    ],
)
def test_a_swap_must_be_kept_without_lost_ticks(state, lost, over):
    verdicts = swap_bench.verdicts({"state": state, "during": {"lost": lost}})
    assert [name for name, (value, _, limit) in verdicts.items() if value > limit] == over
