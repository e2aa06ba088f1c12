"""An episode over Zenoh is the same each time, whatever holds up the processes it consists of."""

from __future__ import annotations

import dataclasses
import random
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest
from simulated import simulated

from edge.errors import Stopped
from edge.lab.eval.arms import make_arms
from edge.lab.eval.drive import over_zenoh, run_episode
from edge.lab.eval.episodes import plan
from edge.lab.eval.outcome import TIMINGS

CONFIG = simulated({"mission": {"time_limit_s": 60.0}})


@contextmanager
def held_up() -> Iterator[list[str]]:
    """Suspend a random child for longer than the resend interval."""
    over, held = threading.Event(), []

    def hold() -> None:
        luck = random.Random(0)
        while not over.wait(luck.uniform(0.2, 0.6)):
            children = [child for child in psutil.Process().children() if is_edge(child)]
            if children:
                child = luck.choice(children)
                with suppress(psutil.NoSuchProcess):  # it ended meanwhile
                    child.send_signal(signal.SIGSTOP)
                    over.wait(luck.uniform(0.6, 1.2))
                    child.send_signal(signal.SIGCONT)
                    held.append(str(child.pid))

    thread = threading.Thread(target=hold)
    thread.start()
    try:
        yield held
    finally:
        over.set()
        thread.join()


def is_edge(process: psutil.Process) -> bool:
    with suppress(psutil.NoSuchProcess):  # as of one that ended
        return any("edge.cli" in word for word in process.cmdline())
    return False


@pytest.mark.slow
def test_an_episode_is_the_same_with_delayed_processes(tmp_path: Path):
    (there,), (column,) = plan(CONFIG, [], ["sofa"], 1, 0, 3.0), make_arms(CONFIG, {})
    first = run_episode(column, there, over_zenoh)
    with held_up() as held:
        second = run_episode(column, there, over_zenoh, page=tmp_path)
    assert len(held) > 2
    one, other = (
        {k: v for k, v in dataclasses.asdict(o).items() if k not in TIMINGS}
        for o in (first, second)
    )
    assert one == other
    assert first.failure != "crashed", first.reason
    assert first.trail[0] == pytest.approx(there.start[:2], abs=0.01)
    assert list(tmp_path.glob("*.html"))


@pytest.mark.parametrize("mapped", ["depth", "cloud"])
def test_an_episode_with_two_cameras(mapped):
    second = {"width_px": 160, "height_px": 128, "yaw_deg": 180.0}
    lidar = {"z_m": 0.4, "pitch_deg": 15.0} if mapped == "cloud" else None
    config = simulated({
        "mission": {"time_limit_s": 60.0}, "mapping": {"input": mapped},
        "sensors": {"second_camera": second, "lidar": lidar},
    })  # fmt: skip
    (there,), (column,) = plan(config, [], ["sofa"], 1, 0, 3.0), make_arms(config, {})
    outcome = run_episode(column, there, over_zenoh)
    assert (outcome.success, outcome.failure) == (True, None), outcome.reason
    assert outcome.detected > 0


def test_an_episode_stopped_before_its_start_has_no_outcome():
    (there,), (column,) = plan(CONFIG, [], ["sofa"], 1, 0, 3.0), make_arms(CONFIG, {})
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        run_episode(column, there, over_zenoh, stop=stop)
