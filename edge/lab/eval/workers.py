"""Runs the jobs of an evaluation in this process or in several; both give the same outcomes.

A job is one episode with one arm. It carries all that it needs, so that nothing depends on earlier
jobs. An error in a job affects only its own outcome.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import connection, get_context
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import cv2

from edge.errors import Stopped
from edge.lab.eval.arms import ExperimentArm
from edge.lab.eval.drive import run_episode
from edge.lab.eval.episodes import Episode
from edge.lab.eval.interrupts import holding_interrupts, ignore_interrupts
from edge.lab.eval.outcome import EpisodeOutcome, crashed_outcomes
from edge.lab.eval.sessions import run_session
from edge.lab.eval.world_list import WorldSection

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""Environment variables that limit numerical libraries to one thread."""
_STOP_CHECK_S = 0.5  # time between two checks for a stop
_END_S = 5.0  # longest wait for the end of a worker process


class EpisodeJob(NamedTuple):
    """One episode to run with one arm.

    Attributes:
        page: folder for a report; None: no report.
    """

    arm: ExperimentArm
    episode: Episode
    page: Path | None = None


def run_job(job: EpisodeJob, stop: threading.Event | None = None) -> list[EpisodeOutcome]:
    """Run a job in this process. A session has an outcome for each goal.

    Raises:
        Stopped: `stop` was set before its end.
    """
    if job.episode.goals:
        return run_session(job.arm, job.episode, stop)
    return [run_episode(job.arm, job.episode, job.page, stop)]


def run_in_process(jobs: Iterable[EpisodeJob], stop: threading.Event) -> Iterator[EpisodeOutcome]:
    """Run the jobs in this process, and yield their outcomes."""
    for job in jobs:
        if stop.is_set():
            return
        try:
            yield from run_job(job, stop)
        except Stopped:
            return


# -- processes ------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Worker:
    """A worker process, its current job, and the world that it loaded last."""

    process: Any
    pipe: connection.Connection
    job: EpisodeJob | None = None
    world: WorldSection | None = None

    def give(self, job: EpisodeJob) -> None:
        """Send a job to the process."""
        self.job, self.world = job, job.episode.world
        self.pipe.send(job)

    def take(self) -> list[EpisodeOutcome]:
        """Return the outcomes of its job; "crashed" if the process ended."""
        job, self.job = self.job, None
        assert job is not None
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            self.process.join(_END_S)
            code = self.process.exitcode
            return crashed_outcomes(
                job.arm, job.episode, f"its worker process ended (exit code {code})"
            )


def run_in_workers(
    jobs: Iterable[EpisodeJob], count: int, stop: threading.Event
) -> Iterator[EpisodeOutcome]:
    """Run the jobs in `count` worker processes of one thread each; yield outcomes as they come.

    If `stop` is set, unfinished jobs have no outcome.
    """
    waiting = deque(jobs)
    workers: list[_Worker] = []
    try:
        while waiting or any(worker.job for worker in workers):
            # A dead worker with a job stays, as `take` reports its crash.
            workers = [worker for worker in workers if worker.job or worker.process.is_alive()]
            while waiting and len(workers) < count:
                workers.append(_start())
            for worker in workers:
                if worker.job is None and waiting:
                    others = [other.world for other in workers if other is not worker]
                    worker.give(take_job(waiting, worker.world, others))
            busy = {worker.pipe: worker for worker in workers if worker.job is not None}
            ready = connection.wait(list(busy), _STOP_CHECK_S)
            if stop.is_set():
                return
            for pipe in ready:
                yield from busy[pipe].take()
    finally:
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.process.join(_END_S)


def take_job(
    waiting: deque[EpisodeJob], loaded: WorldSection | None, others: Sequence[WorldSection | None]
) -> EpisodeJob:
    """Take the next job of a worker: loading a world takes seconds, so each loads its own."""
    index = next((k for k, job in enumerate(waiting) if job.episode.world == loaded), None)
    if index is None:
        free = (k for k, job in enumerate(waiting) if job.episode.world not in others)
        index = next(free, 0)
    job = waiting[index]
    del waiting[index]
    return job


def _start() -> _Worker:
    context = get_context("spawn")
    pipe, child_pipe = context.Pipe()
    process = context.Process(target=_serve, args=(child_pipe,), name="episodes", daemon=False)
    # Libraries read the variables when they load.
    with holding_interrupts(), mock.patch.dict(os.environ, ONE_THREAD):
        process.start()
    child_pipe.close()
    return _Worker(process, pipe)


def _serve(pipe: connection.Connection) -> None:
    """Run the jobs of a pipe until the parent closes it. Ctrl-C is for the parent only."""
    ignore_interrupts()
    cv2.setNumThreads(1)
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        pipe.send(run_job(job))


def outcomes_of(
    jobs: Sequence[EpisodeJob], workers: int, stop: threading.Event
) -> Iterator[EpisodeOutcome]:
    """Run jobs in several processes, or in this one."""
    return run_in_workers(jobs, workers, stop) if workers > 1 else run_in_process(jobs, stop)
