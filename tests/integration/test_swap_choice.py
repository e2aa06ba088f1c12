"""`edge models use` of a model that chooses directions, under load: a recording is played."""

from __future__ import annotations

import argparse
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import pytest
from edge_processes import write_config
from live_patience import PATIENCE_S
from tiny_vlm import publish

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")

from edge.config import load
from edge.host import resources
from edge.lab.eval.house_drive import house_drive
from edge.launch import open_service
from edge.loop.runner import RunningService, loop
from edge.loop.status import status_message
from edge.models import use
from edge.sources.recording import player, record_messages

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]

DETECTOR = "mini-house-256x320-int8-cpu"
SECONDS = 90.0


class Counts(NamedTuple):
    """`lost` are observations that no tick took, since a newer one was there already."""

    observations: int
    ticks: int
    lost: int
    detected: int


def counts_of(running: RunningService) -> Counts:
    counters = running.source.counters
    ticks = running.service.latency.report().tick.count
    detected = running.worker.stats.done
    return Counts(counters["observations"], ticks, counters["superseded"], detected)


@pytest.fixture
def config(tmp_path, monkeypatch, endpoint):
    """Write a configuration with our detector and two choice models, one of them text-only."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    resources.models_dir().mkdir(parents=True)
    publish(resources.models_dir(), "text", "words")
    publish(resources.models_dir(), "smolvlm", "eyes")
    choice = {"kind": "onnx", "card": "words", "threads": 1, "time_limit_s": PATIENCE_S}
    detector = {"kind": "onnx", "model": DETECTOR, "threads": 1}
    return write_config(
        tmp_path, zenoh={"endpoint": endpoint}, perception={"detector": detector, "choice": choice},
        sensors={"camera": {"rate_hz": 4.0}}, mission={"target": "toilet"},
    )  # fmt: skip


def test_choice_models_are_swapped_while_the_loop_runs(config, tmp_path, capsys):
    settings, path = load(str(config)), tmp_path / "tour.mcap"
    record_messages(path, house_drive(settings, SECONDS))
    stop, counted = threading.Event(), []
    with (
        ThreadPoolExecutor(1) as pool,
        open_service(settings, []) as running,
        player(settings, path, loop=True),
    ):
        service, scorers = running.service, running.service.perception.scorers

        def until(what) -> None:
            stop.clear()
            loop(running, stop, each=lambda: what() and stop.set())

        def used(name: str) -> int:
            args = argparse.Namespace(name=name, config=config, force=False, timeout=PATIENCE_S)
            job = pool.submit(use.run, args)
            before = counts_of(running)
            until(job.done)
            after = counts_of(running)
            counted.append(Counts(*(b - a for a, b in zip(before, after, strict=True))))
            return job.result()

        until(lambda: scorers.answers.choice is not None and running.worker.stats.done)
        for name in ("eyes", "mini-house-choice"):
            assert used(name) == 0
            lines = capsys.readouterr().out.splitlines()
            assert lines[0].startswith("loading")
            assert lines[-2].startswith("kept: 3 answers; loaded and asked in")
            assert lines[-1].startswith(
                "valid until the service stops; to keep it, set perception.choice.card"
            )
            choice = status_message(service.result())["scorers"]["choice"]
            assert (choice["model"], choice["failed"]) == (name, 0)
        assert used("smolvlm-256m-q4") == 1  # a card without files
        assert "refused: " in capsys.readouterr().out
        assert scorers.status()["choice"]["model"] == "mini-house-choice"
    for swap in counted:
        assert swap.ticks == swap.observations
        # A loop that stood while a model loads would lose nearly every frame that comes meanwhile;
        # one frame now and then is lost on a busy machine.
        assert swap.lost < max(swap.ticks, 1)
    assert all(swap.detected > 0 and swap.ticks > 0 for swap in counted[:2])
