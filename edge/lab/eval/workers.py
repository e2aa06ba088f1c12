"""Episodes in this process or in several; both give the same outcomes.

A task is an episode with an arm. It carries all that it needs, so that nothing depends on earlier
tasks. An error in a task affects only its own outcome.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection, get_context
from pathlib import Path
from typing import Any, NamedTuple

import cv2

from edge.errors import Stopped
from edge.lab.eval.columns import ExperimentArm
from edge.lab.eval.drive import in_process, over_zenoh, run_episode
from edge.lab.eval.episodes import Episode
from edge.lab.eval.outcome import EpisodeOutcome, crashed_outcomes
from edge.lab.eval.sessions import run_session

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
_LOOK_S = 0.5  # time between two checks for a stop
_END_S = 5.0  # longest wait for the end of a worker process


class EpisodeJob(NamedTuple):
    """An episode with an arm.

    Attributes:
        column: the arm.
        episode: the episode.
        processes: run over Zenoh, with simulator and controller as processes.
        page: folder for a report; None: no report.
    """

    column: ExperimentArm
    episode: Episode
    processes: bool = False
    page: Path | None = None


def run_job(task: EpisodeJob, stop: threading.Event | None = None) -> list[EpisodeOutcome]:
    """Run a task in this process. A session has an outcome for each goal.

    Raises:
        Stopped: `stop` was set before its end.
    """
    if task.episode.goals:
        return run_session(task.column, task.episode, stop)
    drive = over_zenoh if task.processes else in_process
    return [run_episode(task.column, task.episode, drive, task.page, stop)]


def run_in_process(tasks: Iterable[EpisodeJob], stop: threading.Event) -> Iterator[EpisodeOutcome]:
    """Run the tasks in this process, and yield their outcomes."""
    for task in tasks:
        if stop.is_set():
            return
        try:
            yield from run_job(task, stop)
        except Stopped:
            return


# -- processes ------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Worker:
    """A worker process and its current task."""

    process: Any
    pipe: connection.Connection
    task: EpisodeJob | None = None

    def give(self, task: EpisodeJob) -> None:
        self.task = task
        self.pipe.send(task)

    def take(self) -> list[EpisodeOutcome]:
        """Return the outcomes of its task; "crashed" if the process ended."""
        task, self.task = self.task, None
        assert task is not None
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            self.process.join(_END_S)
            code = self.process.exitcode
            return crashed_outcomes(
                task.column, task.episode, f"its worker process ended (exit code {code})"
            )


def run_in_workers(
    tasks: Iterable[EpisodeJob], count: int, stop: threading.Event
) -> Iterator[EpisodeOutcome]:
    """Run the tasks in `count` processes of one thread each; yield outcomes as they are done.

    If `stop` is set, unfinished tasks have no outcome.
    """
    waiting = deque(tasks)
    workers: list[_Worker] = []
    try:
        while waiting or any(worker.task for worker in workers):
            workers = [worker for worker in workers if worker.task or worker.process.is_alive()]
            while waiting and len(workers) < count:
                workers.append(_start())
            for worker in workers:
                if worker.task is None and waiting:
                    worker.give(waiting.popleft())
            busy = {worker.pipe: worker for worker in workers if worker.task is not None}
            ready = connection.wait(list(busy), _LOOK_S)
            if stop.is_set():
                return
            for pipe in ready:
                yield from busy[pipe].take()
    finally:
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.process.join(_END_S)


def _start() -> _Worker:
    context = get_context("spawn")
    pipe, child_pipe = context.Pipe()
    process = context.Process(target=_serve, args=(child_pipe,), name="episodes", daemon=False)
    with _environment(ONE_THREAD):
        process.start()
    child_pipe.close()
    return _Worker(process, pipe)


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables for child processes: libraries read them when they load."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(pipe: connection.Connection) -> None:
    """Run the tasks of a pipe until the parent closes it. Ctrl-C is for the parent only."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        pipe.send(run_job(task))


def outcomes_of(
    tasks: Sequence[EpisodeJob], workers: int, stop: threading.Event
) -> Iterator[EpisodeOutcome]:
    """Run tasks in several processes, or in this one."""
    return run_in_workers(tasks, workers, stop) if workers > 1 else run_in_process(tasks, stop)
