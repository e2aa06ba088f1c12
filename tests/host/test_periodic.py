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
