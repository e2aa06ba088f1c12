"""`edge soak`: start all processes, inject faults, monitor the service, and judge it."""

from __future__ import annotations

import argparse
import logging
import os
import threading
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path

import numpy as np

from edge.config import load
from edge.errors import FAILED, FileError, Stopped
from edge.host.signals import stop_on_signals
from edge.lab.eval.soak.faults import Fault, choose_faults
from edge.lab.eval.soak.harness import SoakHarness, soak_config
from edge.lab.eval.soak.invariants import FaultWindow, check_recovered, log_check
from edge.lab.eval.soak.missions import MissionFeeder, known_labels
from edge.lab.eval.soak.monitor import SoakMonitor
from edge.lab.eval.soak.record import SoakRecord, rows_of_kind, verdict
from edge.lab.eval.soak.rules import (
    GROWTHS,
    RULES,
    allowed_per_h,
    growth_problem,
    growth_slope,
    missions_problem,
)
from edge.lab.eval.soak.schedule import ScheduledFault, Steps, draw_faults, inject
from edge.lab.eval.soak.tables import summary

log = logging.getLogger("edge.lab.eval.soak")

_STEP_PERIOD_S = 0.1  # time between two steps of the run's loop
_SAMPLE_PERIOD_S = 1.0  # time between two samples
_WARM_UP_S = 10.0  # time before the first fault
_MAX_WARM_UP_SHARE = 0.1  # its largest share of the run
_CALM_S = (2.0, 6.0)  # shortest and longest time between two faults
_SETTLES_S = 2.0  # after the recovery from a fault: its samples are not yet as before


def run(args: argparse.Namespace) -> int:
    """Handle `edge soak` and return the exit code (see `edge.errors`)."""
    stop = stop_on_signals()
    config = load(args.config)
    faults = choose_faults(config, args.faults.split(",") if args.faults is not None else None)
    known_labels(config, config.sim.world)  # check before the start, which takes minutes
    make_out_folder(args.out)
    out = args.out.resolve()
    record = SoakRecord(out / "record.jsonl")
    with closing(record), closing(SoakHarness(soak_config(config, out), out, stop)) as harness:
        soak = SoakRun(harness, record, faults, args.seed, 60.0 * args.minutes)
        try:
            harness.start()
        except Stopped:
            log.info("soak stopped by request before simulator, controller and service had started")
            return os.EX_OK
        with suppress(Stopped):  # as the end of a fault waits for a connection
            soak.run(stop)
        soak.conclude()
    print(summary(record.rows))
    print(verdict(record.rows))
    return FAILED if rows_of_kind(record.rows, "broken") else os.EX_OK


def make_out_folder(folder: Path) -> None:
    """Make the folder if it is missing; refuse one that is not empty.

    Raises:
        FileError: it cannot be made, or it is not empty.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise FileError(f"--out {folder}: the folder is not empty; choose another")
    except OSError as error:
        raise FileError(
            f"--out {folder}: cannot be used: {error.strerror}; choose another folder"
        ) from None


class SoakRun:
    """Drives one soak run: faults, missions, samples, then the verdict.

    Call `run`, then `conclude`.
    """

    def __init__(
        self,
        harness: SoakHarness,
        record: SoakRecord,
        faults: Sequence[Fault],
        seed: int,
        lasts_s: float,
    ) -> None:
        self._harness, self._record, self._faults = harness, record, faults
        # Separate streams: the order of faults depends on the seed only, not on their duration.
        self._schedule_rng, self._fault_rng, self._mission_rng = map(
            np.random.default_rng, np.random.SeedSequence(seed).spawn(3)
        )
        self._lasts_s = lasts_s
        self._reported: set[str] = set()
        record.add("begin", seed=seed, minutes=lasts_s / 60.0, faults=[f.name for f in faults],
                   config=harness.config.model_dump(mode="json"))  # fmt: skip

    def run(self, stop: threading.Event) -> None:
        """Run until the time is over and the current fault has ended.

        It ends early if `stop` is set, or if the run cannot continue.
        """
        self._monitor = SoakMonitor(self._harness)
        self._missions = MissionFeeder(self._harness, self._monitor, self._mission_rng)
        self._record.began_s = time.monotonic()
        ends_s, sample_s = self._record.began_s + self._lasts_s, 0.0
        with closing(self._all_faults(ends_s)) as faults:
            for _ in faults:
                self._harness.relay.step()
                self._harness.log.poll()
                if (end := self._missions.step()) is not None:
                    self._record.add("mission", **end)
                if time.monotonic() >= sample_s:
                    sample_s = max(sample_s + _SAMPLE_PERIOD_S, time.monotonic())
                    if self._take_sample():
                        return
                if stop.wait(_STEP_PERIOD_S):
                    return

    def _take_sample(self) -> bool:
        """Take a sample and check the rules. Return True if the run cannot continue."""
        sample = self._monitor.take_sample()
        self._record.add("sample", calm=self._monitor.calm, **sample)
        for rule in RULES:
            if why := rule.problem(self._harness, self._monitor, sample):
                self._report_broken(rule.name, why)
                if rule.ends_run:
                    return True
        return False

    def _report_broken(self, rule: str, why: str) -> None:
        """Report a broken rule, each rule only once."""
        if rule not in self._reported:
            self._reported.add(rule)
            log.error("check failed: %s: %s", rule, why)
            self._record.add("broken", rule=rule, why=why)

    # -- faults ---------------------------------------------------------------------------------

    def _all_faults(self, ends_s: float) -> Steps:
        """Inject the faults, one step each time that the generator is resumed.

        This is a generator of `Steps`: resumed once per loop, it returns the reason of a failure,
        or "". Here failures are recorded at once, so the returned text is always "".
        """
        yield from self._pause(min(_WARM_UP_S, _MAX_WARM_UP_SHARE * self._lasts_s))
        for drawn in draw_faults(self._faults, self._schedule_rng):
            yield from self._inject(drawn)
            yield from self._pause(float(self._schedule_rng.uniform(*_CALM_S)))
            if time.monotonic() >= ends_s:
                return ""
        return ""

    def _pause(self, lasts_s: float) -> Steps:
        """Do nothing for a time."""
        until_s = time.monotonic() + lasts_s
        while time.monotonic() < until_s:
            yield
        return ""

    def _inject(self, drawn: Sequence[ScheduledFault]) -> Steps:
        """Inject a fault, or one within another, and wait until the service has recovered."""
        monitor, began_s = self._monitor, time.monotonic()
        faults = [fault for fault, _ in drawn]
        name, alone = " + ".join(fault.name for fault in faults), len(faults) == 1
        monitor.calm = False
        why = yield from inject(drawn, self._harness, monitor, self._fault_rng)
        monitor.bus_is_muted, ended_s = False, time.monotonic()
        if not alone:
            why = ""  # one of two faults may hide the other, or make it impossible
        why = why or (yield from self._wait_for_recovery(faults, FaultWindow(began_s, ended_s)))
        self._record.add(
            "fault", name=name, began_s=round(began_s - self._record.began_s, 2),
            lasted_s=round(ended_s - began_s, 2),
            recovered_s=round(time.monotonic() - ended_s, 2), broken=why,
        )  # fmt: skip
        if why:
            self._report_broken(f"fault {name}", why)
        yield from self._pause(_SETTLES_S)
        monitor.calm = True

    def _wait_for_recovery(self, faults: Sequence[Fault], window: FaultWindow) -> Steps:
        """Wait until all conditions hold. Return the first reason if it takes too long."""
        conditions = [check_recovered, *(check for fault in faults for check in fault.after)]
        if len(faults) == 1 and faults[0].log_pattern:
            conditions.append(log_check(faults[0].log_pattern))
        within_s = sum(fault.within_s for fault in faults)
        while True:
            problems = (check(self._harness, self._monitor, window) for check in conditions)
            if not (why := next(filter(None, problems), "")):
                return ""
            if time.monotonic() - window.ended_s > within_s:
                return f"not recovered after {within_s:g} s: {why}"
            yield

    # -- the end --------------------------------------------------------------------------------

    def conclude(self) -> None:
        """Judge the entire run, and stop the service."""
        ran_s = time.monotonic() - self._record.began_s
        samples = rows_of_kind(self._record.rows, "sample")
        for growth in GROWTHS:
            slope = growth_slope(growth, samples)
            if slope is not None:
                self._record.add(
                    "growth", name=growth.name, unit=growth.unit,
                    most_per_h=round(allowed_per_h(growth, ran_s), 1), **slope._asdict(),
                )  # fmt: skip
            if why := growth_problem(growth, slope, ran_s):
                self._report_broken(growth.name, why)
        if why := missions_problem(self._missions.ended, ran_s):
            self._report_broken("missions", why)
        self._harness.update_descendants()
        code = self._harness.stop_service()
        if code != os.EX_OK:
            self._report_broken(
                "service ends",
                "it did not end in time" if code is None else f"exit code {code}, expected 0",
            )
        recorded = self._monitor.recordings.judge()
        self._record.add("recordings", **recorded)
        if why := self._monitor.recordings.problem:
            self._report_broken("recordings", why)
        if left := self._harness.orphans():
            names = ", ".join(process.command[:60] for process in left)
            self._report_broken(
                "no child is left", f"{len(left)} processes of the service still run: {names}"
            )
        self._record.add("end", faults=len(rows_of_kind(self._record.rows, "fault")),
                         missions=len(self._missions.ended))  # fmt: skip
