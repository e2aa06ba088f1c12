"""A step that cannot be stopped is left to its thread."""

from __future__ import annotations

import threading
from functools import partial

import pytest

from edge.errors import Stopped
from edge.host.interruptible import any_detached_thread, raise_if_stopped, run_unless_stopped


@pytest.fixture
def stop() -> threading.Event:
    return threading.Event()


def test_the_result_or_exception_of_the_step_is_passed_on(stop):
    assert run_unless_stopped(lambda: 7, stop) == 7
    with pytest.raises(ZeroDivisionError):
        run_unless_stopped(lambda: 1 // 0, stop)
    stop.set()
    for too_late in (raise_if_stopped, partial(run_unless_stopped, pytest.fail)):
        with pytest.raises(Stopped):
            too_late(stop)


def test_an_endless_step_is_abandoned_at_a_stop(stop):
    over, threads = threading.Event(), []

    def work() -> None:
        threads.append(threading.current_thread())
        stop.set()
        over.wait()

    with pytest.raises(Stopped):
        run_unless_stopped(work, stop)
    (thread,) = threads
    assert thread.daemon
    assert any_detached_thread()
    over.set()
    thread.join()
