"""`edge soak`: start all processes, inject faults, monitor the service, and judge it."""

from __future__ import annotations

import argparse
import logging
import os
import threading
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from edge.config import load
from edge.errors import FAILED, FileError, Stopped
from edge.host.signals import stop_on_signals
from edge.lab.eval.soak.faults import Fault, chosen
from edge.lab.eval.soak.harness import SoakHarness, soak_config
from edge.lab.eval.soak.invariants import FaultWindow, log_has, recovered
from edge.lab.eval.soak.missions import MissionFeeder
from edge.lab.eval.soak.monitor import SoakMonitor
from edge.lab.eval.soak.record import SoakLog, of, verdict
from edge.lab.eval.soak.rules import GROWTHS, RULES, grown, grows, most_per_h, none_reached
from edge.lab.eval.soak.schedule import ScheduledFault, Steps, make, rounds
from edge.lab.eval.soak.tables import summary

log = logging.getLogger("edge.lab.eval.soak")

_STEP_S = 0.1
_LOOK_S = 1.0  # time between two samples
_WARM_UP_S, _WARM_UP = 10.0, 0.1  # time before the first fault, and its largest share of the run
_CALM_S = (2.0, 6.0)  # shortest and longest time between two faults
_SETTLES_S = 2.0  # after a fault, the samples are not yet as before


def run(args: argparse.Namespace) -> int:
    """Handle `edge soak` and return the exit code (see `edge.errors`).

    Raises:
        UserError: it cannot start with this configuration, faults, folder or service.
    """
    stop = stop_on_signals()
    config = load(args.config)
    faults = chosen(config, args.faults.split(",") if args.faults is not None else None)
    make_empty(args.out)
    out = args.out.resolve()
    record = SoakLog(out / "record.jsonl")
    with closing(record), closing(SoakHarness(soak_config(config, out), out, stop)) as harness:
        soak = SoakRun(harness, record, faults, args.seed, 60.0 * args.minutes)
        try:
            harness.start()
            soak.run(stop)
        except Stopped:
            log.info("soak stopped by request before simulator, controller and service had started")
            return os.EX_OK
        soak.conclude()
    print(summary(record.rows))
    print(verdict(record.rows))
    return FAILED if of(record.rows, "broken") else os.EX_OK


def make_empty(folder: Path) -> None:
    """Make a folder, if it is missing.

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
    """One soak run."""

    def __init__(
        self,
        harness: SoakHarness,
        record: SoakLog,
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
        ends_s, look_s = self._record.began_s + self._lasts_s, 0.0
        with closing(self._all_faults(ends_s)) as faults:
            for _ in faults:
                self._harness.relay.step()
                self._harness.log.poll()
                if (end := self._missions.step()) is not None:
                    self._record.add("mission", **end)
                if time.monotonic() >= look_s:
                    look_s = max(look_s + _LOOK_S, time.monotonic())
                    if self._take_sample():
                        return
                if stop.wait(_STEP_S):
                    return

    def _take_sample(self) -> bool:
        """Take a sample and check the rules. Return True if the run cannot continue."""
        sample = self._monitor.look()
        self._record.add("sample", calm=self._monitor.calm, **sample)
        for rule in RULES:
            if why := rule.broken(self._harness, self._monitor, sample):
                self._report_broken(rule.name, why)
                if rule.ends:
                    return True
        return False

    def _report_broken(self, rule: str, why: str) -> None:
        """Report a broken rule, once a rule."""
        if rule not in self._reported:
            self._reported.add(rule)
            log.error("check failed: %s: %s", rule, why)
            self._record.add("broken", rule=rule, why=why)

    # -- faults ---------------------------------------------------------------------------------

    def _all_faults(self, ends_s: float) -> Steps:
        """Inject the faults, one step each time that the generator is resumed."""
        yield from self._pause(min(_WARM_UP_S, _WARM_UP * self._lasts_s))
        for drawn in rounds(self._faults, self._schedule_rng):
            yield from self._inject(drawn)
            yield from self._pause(float(self._schedule_rng.uniform(*_CALM_S)))
            if time.monotonic() >= ends_s:
                return ""
        return ""

    def _pause(self, lasts_s: float) -> Steps:
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
        why = yield from make(drawn, self._harness, monitor, self._fault_rng)
        monitor.mutes, ended_s = False, time.monotonic()
        why = why if alone else ""
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
        """Wait until all holds after the faults. Return the first reason if it takes too long."""
        holds = [recovered, *(hold for fault in faults for hold in fault.after)]
        if len(faults) == 1 and faults[0].log_pattern:
            holds.append(log_has(faults[0].log_pattern))
        within_s = sum(fault.within_s for fault in faults)
        while True:
            every = (hold(self._harness, self._monitor, window) for hold in holds)
            if not (why := next(filter(None, every), "")):
                return ""
            if time.monotonic() - window.ended_s > within_s:
                return f"not recovered after {within_s:g} s: {why}"
            yield

    # -- the end --------------------------------------------------------------------------------

    def conclude(self) -> None:
        """Judge the whole run, and stop the service."""
        ran_s = time.monotonic() - self._record.began_s
        samples = of(self._record.rows, "sample")
        for growth in GROWTHS:
            slope = grown(growth, samples)
            if slope is not None:
                self._record.add(
                    "growth", name=growth.name, unit=growth.unit,
                    most_per_h=round(most_per_h(growth, ran_s), 1), **slope._asdict(),
                )  # fmt: skip
            if why := grows(growth, slope, ran_s):
                self._report_broken(growth.name, why)
        if why := none_reached(self._missions.ended, ran_s):
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
        self._record.add("end", faults=len(of(self._record.rows, "fault")),
                         missions=len(self._missions.ended))  # fmt: skip
