"""Frames are used again only when every reader has let go."""

from __future__ import annotations

import threading

import pytest

from edge.sources.pool import FramePool


def test_a_slot_is_free_after_its_last_release():
    pool = FramePool(2, (1, 1))
    first, second = pool.acquire(), pool.acquire()
    assert first is not second
    assert pool.acquire() is None
    first.hold()
    first.release()
    assert pool.acquire() is None
    first.release()
    assert pool.acquire() is first


def test_unbalanced_readers_raise():
    slot = FramePool(1, (1, 1)).acquire()
    slot.release()
    with pytest.raises(RuntimeError, match="released more often"):
        slot.release()
    with pytest.raises(RuntimeError, match="after its last reader"):
        slot.hold()


def test_readers_in_other_threads_never_see_a_frame_written_over():
    pool, wrong = FramePool(3, (8, 8)), []

    def read(slot, value):
        for _ in range(20):
            if not (slot.rgb == value).all():
                wrong.append(value)
        slot.release()

    threads = []
    for value in range(200):
        slot = pool.acquire()
        if slot is None:
            threads.pop(0).join()
            continue
        slot.rgb[:] = value
        slot.hold()
        threads.append(threading.Thread(target=read, args=(slot, value)))
        threads[-1].start()
        slot.release()
    for thread in threads:
        thread.join()
    assert not wrong
