"""Runs all planners on all tasks at all p_obs, in parallel processes.

p_obs is the probability that an exploration finds its target. A delexicalised formula has
placeholders in place of the objects. Tasks that share one run together, so that automaton and plans
are made once for all of them.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge.errors import UserError
from edge.lab.eval.interrupts import holding_interrupts, ignore_interrupts
from edge.lab.eval.planning.delexicalised import delexicalise
from edge.lab.eval.planning.executor import COMPLETE, PlanningProblem, draws_of, run_episode
from edge.lab.eval.planning.planners import PLANNERS
from edge.lab.eval.planning.templates import BenchmarkTask

BATCH_EPISODES = 20
"""Episodes of one planner at one p_obs between two checks for a stop."""


class Settings(NamedTuple):
    """The settings of a sweep.

    Attributes:
        planners: names in `PLANNERS`.
        p_obs: each in (0, 1], with at most six decimals.
        episodes: number for each task, planner and p_obs.
        seed: of the random numbers.
    """

    planners: tuple[str, ...]
    p_obs: tuple[float, ...]
    episodes: int = 1
    seed: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class SweepResults:
    """Every episode of a comparison.

    Attributes:
        outcome: (planners, p_obs, tasks, episodes) int8 index into `executor.OUTCOMES`.
        explorations: the same shape, int32.
        steps: the same shape, int32.
        bound: (tasks,) int32, steps of the shortest accepted trace.
    """

    planners: tuple[str, ...]
    p_obs: tuple[float, ...]
    outcome: np.ndarray
    explorations: np.ndarray
    steps: np.ndarray
    bound: np.ndarray

    @property
    def complete(self) -> np.ndarray:
        """(planners, p_obs, tasks, episodes) bool."""
        return self.outcome == COMPLETE


class TaskBatch(NamedTuple):
    """Tasks with one delexicalised formula, for one process.

    Attributes:
        rows: index of each task in the results.
    """

    problem: PlanningProblem
    rows: list[int]
    ids: list[int]


def run_tasks(
    tasks: Sequence[BenchmarkTask],
    settings: Settings,
    workers: int = 1,
    progress: Callable[[int], None] = lambda done: None,
) -> SweepResults:
    """Run the comparison; the results do not depend on `workers`.

    Raises:
        CompileError: a formula is beyond the compiler's limits.
        UserError: a process was killed.
    """
    shape = (len(settings.planners), len(settings.p_obs), len(tasks), settings.episodes)
    results = SweepResults(
        settings.planners, settings.p_obs, np.zeros(shape, np.int8), np.zeros(shape, np.int32),
        np.zeros(shape, np.int32), np.zeros(len(tasks), np.int32),
    )  # fmt: skip
    work = list(_batches(tasks, max(1, BATCH_EPISODES // settings.episodes)))
    done = 0
    for batch, part in _run_all(work, settings, workers):
        results.outcome[:, :, batch.rows], results.explorations[:, :, batch.rows] = part[:2]
        results.steps[:, :, batch.rows] = part[2]
        results.bound[batch.rows] = batch.problem.steps_left[0]
        done += len(batch.rows)
        progress(done)
    return results


def _batches(tasks: Sequence[BenchmarkTask], size: int) -> Iterator[TaskBatch]:
    rows: dict = {}  # by delexicalised formula: indices of its tasks
    for row, task in enumerate(tasks):
        rows.setdefault(delexicalise(task.formula), []).append(row)
    for delexicalised, members in rows.items():
        problem = PlanningProblem.of(delexicalised.automaton, delexicalised.others)
        for i in range(0, len(members), size):
            part = members[i : i + size]
            yield TaskBatch(problem, part, [tasks[row].id for row in part])


def run_batch(batch: TaskBatch, settings: Settings) -> np.ndarray:
    """Return outcomes, explorations and steps of a batch.

    Returns:
        (3, planners, p_obs, tasks, episodes) int32.
    """
    problem = batch.problem
    shape = (len(settings.planners), len(settings.p_obs), len(batch.ids), settings.episodes)
    results = np.zeros((3, *shape), np.int32)
    everything = (1 << problem.n_objects) - 1
    # (index, function that makes the planner for a p_obs, places known from the start)
    entrants = [
        (k, PLANNERS[name].make(problem), everything if PLANNERS[name].knows_all_places else 0)
        for k, name in enumerate(settings.planners)
    ]
    for j, p_obs in enumerate(settings.p_obs):
        choosers = [(k, make(p_obs), seen) for k, make, seen in entrants]
        for i, task in enumerate(batch.ids):
            for e in range(settings.episodes):
                draws = draws_of(settings.seed, task, p_obs, e)
                for k, choose, seen in choosers:
                    episode = run_episode(problem, p_obs, choose, draws, seen)
                    results[:, k, j, i, e] = episode
    return results


def _run_all(
    work: list[TaskBatch], settings: Settings, workers: int
) -> Iterator[tuple[TaskBatch, np.ndarray]]:
    """Yield batches with their results, in the order of completion."""
    if workers == 1:
        yield from ((batch, run_batch(batch, settings)) for batch in work)
        return
    # A fork could copy locks that threads of the numerical libraries hold.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), ignore_interrupts)
    try:
        with holding_interrupts():
            futures = {pool.submit(run_batch, batch, settings): batch for batch in work}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenProcessPool:
        raise UserError(
            "a process of the evaluation was killed, perhaps out of memory; give fewer --workers"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)
