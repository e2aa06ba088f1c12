from __future__ import annotations

import threading

from patience import eventually

from edge.host.periodic import run_periodically


def test_the_work_repeats_until_the_block_ends():
    done = []
    with run_periodically("work", 1e-4, lambda: done.append(threading.current_thread().name)):
        eventually(lambda: len(done) >= 3)
    assert set(done) == {"work"}
    assert "work" not in {thread.name for thread in threading.enumerate()}


def test_an_error_is_logged_once_for_each_type_and_the_work_goes_on(caplog):
    errors = [OSError("a"), OSError("b"), ValueError("c")]
    calls = []

    def work():
        calls.append(1)
        if errors:
            raise errors.pop(0)

    with run_periodically("work", 1e-4, work):
        eventually(lambda: len(calls) >= 5)
    assert [record.exc_info[0] for record in caplog.records] == [OSError, ValueError]
