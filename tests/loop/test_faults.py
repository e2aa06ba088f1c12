"""Error boundary of the loop: errors are counted, logged once, and `degraded` if they stay."""

from __future__ import annotations

import pytest

from edge.errors import Stopped
from edge.loop.error_boundary import DEGRADED_AFTER, ErrorBoundary


@pytest.fixture
def notes() -> list[str]:
    return []


@pytest.fixture
def faults(notes) -> ErrorBoundary:
    return ErrorBoundary(lambda text, now_ns: notes.append(f"{now_ns} {text}"))


def fail(
    faults: ErrorBoundary, times: int = 1, step: str = "tick", error=ZeroDivisionError
) -> None:
    for _ in range(times):
        with faults.contain(step, 5):
            raise error("oh\n\x1b[31mno")


def test_nothing_failed(faults, notes):
    with faults.contain("tick", 5):
        pass
    assert faults.status() == {"state": "ok", "failed": 0, "last_error": "", "failures": {}}
    assert notes == []


def test_each_kind_is_reported_once_on_one_line_and_counted(faults, notes, caplog):
    fail(faults, 3)
    fail(faults, 2, error=KeyError)
    fail(faults, 1, step="orders")
    kinds = {"tick: ZeroDivisionError": 3, "tick: KeyError": 2, "orders: ZeroDivisionError": 1}
    assert faults.failures == kinds
    assert faults.failed == 6
    assert [text.split(" at ")[0] for text in notes] == [f"5 failed: {kind}" for kind in kinds]
    assert notes[0].endswith(": oh [31mno")
    assert "test_faults.py:" in faults.last_error
    assert len([r for r in caplog.records if r.levelname == "ERROR"]) == 3


@pytest.mark.parametrize("nothing", [None, [], False, 0])
def test_a_step_without_work_does_not_end_the_degraded_state(faults, nothing):
    def bad() -> None:
        raise ValueError

    for _ in range(DEGRADED_AFTER):
        assert faults.call("source", 5, bad) is None
        assert faults.call("source", 5, lambda: nothing) == nothing
    assert faults.state == "degraded"
    assert faults.call("source", 6, lambda: [7]) == [7]
    assert faults.state == "ok"


def test_repeated_failures_set_degraded_and_success_ends_it(faults, notes):
    fail(faults, DEGRADED_AFTER - 1)
    with faults.contain("tick", 6):
        pass
    fail(faults, DEGRADED_AFTER - 1)
    with faults.contain("orders", 6):  # another step
        pass
    assert faults.state == "ok"
    fail(faults)
    assert faults.state == "degraded"
    assert "degraded: tick keeps failing: tick: ZeroDivisionError" in notes[-1]
    fail(faults, 5)
    with faults.contain("tick", 7):
        pass
    assert faults.state == "ok"
    assert notes[-1] == "7 tick: works again"
    assert len(notes) == 3


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, Stopped])
def test_exceptions_that_end_the_process_are_not_contained(faults, error):
    with pytest.raises(error), faults.contain("tick", 5):
        raise error
    assert faults.failed == 0
