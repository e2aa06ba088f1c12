"""What a robot explores twice when its service is killed: python perf/revisited.py --help.

In each world a robot explores, and half-way its service is killed as by `kill -9`: nothing is
written any more, and the robot drives on to its last goal until another service has read what was
kept. Once it reads all, once only the mission, as before places were kept.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge.config import Config, parse
from edge.eval.closed_loop import ClosedLoop, Notes
from edge.eval.intervals import ratio
from edge.eval.world_list import sections
from edge.loop.keeper import Keeper
from edge.loop.service import Service
from edge.mapping.grid import RollingMap
from edge.perception.factory import make_detector
from edge.perception.worker import DetectorWorker
from edge.policies import make_policy

DOWN_S = 4.0
LIMIT_S = 600.0


class Twice(NamedTuple):
    """After a kill: area known before that was explored anew, of how much, and the way driven until
    nothing was left to explore."""

    again_m2: float
    known_m2: float
    path_m: float


class Robot(ClosedLoop):
    """Drives by a service that keeps what it knows at `path`."""

    def __init__(self, config: Config, path: Path) -> None:
        super().__init__(config, colour=False)
        self.path = path
        self.start()

    def start(self) -> None:
        keeper = Keeper(self.config, self.path, None)
        brief = keeper.brief() or self.service.mission.brief
        detector = make_detector(self.config.perception, brief.targets, truth=self.truth)
        self.worker = DetectorWorker(detector, inline=True)
        policy = make_policy(self.config.policy)
        self.notes = Notes()
        self.service = Service(self.config, brief, self.worker, policy, [self.notes], keeper)

    def explore(
        self, until_m2: float = np.inf, each: list[tuple[float, float]] | None = None
    ) -> None:
        """Until so much is known, or nothing is left to go to; notes (known m2, way) by the way."""
        for n in range(int(LIMIT_S / self.config.sim.step_s)):
            self.step()
            while not self.service.keeper.places.idle:  # simulated time is faster than a disk
                time.sleep(0.0005)
            done = self.service.status.done or self.service.goals.searched
            if n % 5 == 0 or done:
                known_m2 = self.service.map.grid.known_m2
                if each is not None:
                    each.append((known_m2, self.service.mission.path_m))
                if done or known_m2 >= until_m2:
                    return

    def coast(self, seconds: float) -> None:
        """No service: the controller ends its last goal."""
        for _ in range(int(seconds / self.config.sim.step_s)):
            motion = self.drive.motion
            command, _ = self.controller.step(
                motion.odometry, motion.v_mps, motion.w_radps, motion.stamp_ns
            )
            self.drive.step(self.config.sim.step_s, command.v_mps, command.w_radps)


def known(seen: RollingMap | None) -> set[tuple[int, int]]:
    """World cells that were seen."""
    if seen is None:
        return set()
    grid = seen.snapshot()
    x0, y0 = np.round(np.array(grid.origin_xy_m) / grid.resolution_m).astype(int)
    rows, columns = np.nonzero(grid.cells >= 0)
    return set(zip((columns + x0).tolist(), (rows + y0).tolist(), strict=True))


def killed(config: Config, folder: Path, half_m2: float, keeps: bool) -> Twice:
    """A run that is killed when so much is known."""
    path = folder / "mission.json"
    robot = Robot(config, path)
    robot.explore(half_m2)
    before = known(robot.service.map.grid)
    robot.coast(DOWN_S)
    if not keeps:
        path.with_name("mission.json.map").unlink(missing_ok=True)
    robot.start()
    driven_m = robot.service.mission.path_m
    kept = known(robot.service.keeper.places.waiting)
    robot.explore()
    robot.service.keeper.close()
    again = (before - kept) & known(robot.service.map.grid)
    area_m2 = config.mapping.resolution_m**2
    return Twice(
        len(again) * area_m2, len(before) * area_m2, robot.service.mission.path_m - driven_m
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", nargs="+", default=["house:demo", "generated[1000:1012]"])
    args = parser.parse_args()
    rows: list[tuple[Twice, Twice, float]] = []
    for section in sections(args.worlds):
        data = {
            "loop": {"lockstep": True}, "perception": {"detector": {"kind": "sim"}},
            "sim": {"lockstep": True, "step_s": 0.2, "world": section},
            # Nothing of that name is there: all that can be reached is explored.
            "mission": {"target": "submarine", "time_limit_s": 10 * LIMIT_S, "path_limit_m": 1e6},
            "policy": {"kind": "search"},
        }  # fmt: skip
        config = parse(data)
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            whole = Robot(config, Path(folder) / "mission.json")
            ways: list[tuple[float, float]] = []  # known, and the way until then
            whole.explore(each=ways)
            whole.service.keeper.close()
        half_m2 = 0.5 * whole.service.map.grid.known_m2
        rest_m = whole.service.mission.path_m - next(m for m2, m in ways if m2 >= half_m2)
        with (
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as one,
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as other,
        ):
            kept = killed(config, Path(one), half_m2, True)
            lost = killed(config, Path(other), half_m2, False)
        rows.append((kept, lost, rest_m))
        print(
            f"{section}: known {kept.known_m2:.0f} m2; explored again {kept.again_m2:.1f} m2 with "
            f"the map, {lost.again_m2:.1f} without; way to the end {rest_m:.0f} m unbroken, "
            f"{kept.path_m:.0f} with, {lost.path_m:.0f} without", flush=True,
        )  # fmt: skip
    kept, lost = (np.array([row[i] for row in rows]) for i in (0, 1))
    rest_m, each = np.array([row[2] for row in rows]), np.ones(len(rows))
    for name, figure in (
        ("explored again with the map, share", ratio(kept[:, 0], kept[:, 1])),
        ("explored again without it, share", ratio(lost[:, 0], lost[:, 1])),
        ("way that the map saves, m", ratio(lost[:, 2] - kept[:, 2], each)),
        ("way beyond an unbroken run, m", ratio(kept[:, 2] - rest_m, each)),
    ):
        value, low, high = figure
        print(f"{name}: {value:.3f} [{low:.3f}, {high:.3f}], {len(rows)} worlds")


if __name__ == "__main__":
    main()
