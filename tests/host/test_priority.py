from __future__ import annotations

import logging
import os

import pytest

from edge.host.priority import real_time


def policy() -> int:
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


def test_the_priority_ends_with_the_block():
    with real_time(5) as given:
        if not given:
            pytest.skip("no right to real-time priority here")
        assert policy() == os.SCHED_FIFO
        assert os.sched_getparam(0).sched_priority == 5
    assert policy() == os.SCHED_OTHER


def test_the_priority_ends_without_a_capability(monkeypatch, caplog):
    """LimitRTPRIO is enough: Linux then refuses only to clear SCHED_RESET_ON_FORK."""
    policies = [os.SCHED_OTHER]

    def linux(_pid, policy, _param):
        if policies[-1] & os.SCHED_RESET_ON_FORK and not policy & os.SCHED_RESET_ON_FORK:
            raise PermissionError(1, "Operation not permitted")
        policies.append(policy)

    monkeypatch.setattr(os, "sched_setscheduler", linux)
    with real_time(5) as given:
        assert given
    assert policies[-1] & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
    assert caplog.messages == []


def test_a_missing_permission_is_reported_and_survived(monkeypatch, caplog):
    def refuse(*_args):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with caplog.at_level(logging.WARNING, "edge.host.priority"), real_time(5) as given:
        assert not given
    assert "loop.priority: 5 is not permitted" in caplog.text
