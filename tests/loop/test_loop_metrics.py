"""The service as Prometheus sees it: at every moment of its life, and from another thread."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest
from prometheus_client.parser import text_string_to_metric_families
from simulated import simulated
from test_loops import running_of

from edge.host.board import BoardReading
from edge.host.service_manager import SystemdNotifier
from edge.host.worker import WorkerStats
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.monitoring.metrics import BOARD_METRICS, HEALTH_METRICS, SERVICE_METRICS, Metrics
from edge.loop.monitoring.service_health import ServiceHealth
from edge.loop.publish import statuses
from edge.loop.reload import Reloader
from edge.loop.runner import RunningService

MISSION = 'go to the bed"} 1\n' + "x" * 10_000
HOT = BoardReading(
    {"cpu": 51.5}, {("cpu", "passive"): 95.0}, {"gpu": 0.5}, {"oc1": 2}, {"VDD_IN": 8.0},
    {"total": 1000, "available": 400}, "25W",
)  # fmt: skip


class Watched:
    """A closed loop and its metrics; `scrape` as Prometheus' own parser reads them."""

    def __init__(self, board: BoardReading = HOT, **sections: dict) -> None:
        self.vitals = ServiceHealth(SystemdNotifier({}))
        self.metrics = Metrics(self.vitals, lambda: board)
        lockstep = {"loop": {"lockstep": True}, "sim": {"lockstep": True}}
        self.closed = ClosedLoop(
            simulated({**lockstep, "mission": {"target": "bed"}, **sections}), colour=False
        )
        self.running: RunningService = running_of(self.closed, [])

    def watch(self, *sinks: object) -> Watched:
        self.metrics.add_service(self.running, sinks)
        return self

    def page(self) -> str:
        return self.metrics.pages()["/metrics"]().body.decode()

    def scrape(self) -> dict[str, dict[str | tuple[str, ...], float]]:
        """Sample → its label's value, or several (by their names' order) → value; without `le`."""
        found: dict[str, dict[str | tuple[str, ...], float]] = {}
        for family in text_string_to_metric_families(self.page()):
            for sample in family.samples:
                values = tuple(v for k, v in sorted(sample.labels.items()) if k != "le")
                key = values[0] if len(values) == 1 else values
                found.setdefault(sample.name, {})[key] = sample.value
        return found


@pytest.fixture(scope="module")
def watched() -> Watched:
    """After ten ticks."""
    watched = Watched().watch()
    for _ in range(10):
        watched.closed.step()
    return watched


def test_metrics_at_startup_show_the_state_and_the_board():
    watched = Watched()
    found = watched.scrape()
    assert found["edge_service_state"]["starting"] == 1
    assert found["edge_service_ready"] == {(): 0}
    assert found["edge_board_temperature_celsius"] == {"cpu": 51.5}
    assert found["edge_board_trip_celsius"] == {("passive", "cpu"): 95.0}
    assert found["edge_board_over_current_total"] == {"oc1": 2}
    assert found["edge_board_power_mode_info"] == {"25W": 1}
    assert "edge_tick_duration_seconds_count" not in found


def test_after_some_ticks(watched):
    found, loop = watched.scrape(), watched.closed
    assert found["edge_tick_duration_seconds_count"] == {(): 10}
    assert found["edge_tick_interval_seconds_count"] == {(): 9}
    assert found["edge_stage_duration_seconds_count"]["detect"] == 10
    assert found["edge_detector_images_total"]["detected"] == 10
    assert found["edge_detector_state"]["ok"] == 1
    assert found["edge_model_info"] == {
        (loop.service.perception.worker.detector.name, "detector"): 1
    }
    assert found["edge_mission_state"][loop.service.status.phase] == 1
    assert sum(found["edge_mission_state"].values()) == 1
    assert found["edge_mission_targets"] == {(): 1}
    assert found["edge_mission_plan_steps"] == {(): 1}
    assert found["edge_map_known_square_meters"][()] == loop.service.map.grid.known_m2 > 0
    assert found["edge_map_frontiers"][()] == loop.service.map.grid.frontiers.n > 0
    assert found["edge_goal_state"][loop.service.goals.goal.kind] == 1
    assert found["edge_policy_info"] == {loop.config.policy.kind: 1}


def test_every_metric_has_its_help_and_type(watched):
    page = watched.page()
    for metric in (*HEALTH_METRICS, *SERVICE_METRICS, *BOARD_METRICS):
        kind = "gauge" if metric.kind == "state" else metric.kind
        assert f"# HELP {metric.name} " in page
        assert f"# TYPE {metric.name} {kind}\n" in page


def test_names_follow_prometheus_rules():
    metrics = [*HEALTH_METRICS, *SERVICE_METRICS, *BOARD_METRICS]
    assert len({metric.name for metric in metrics}) == len(metrics)
    for metric in metrics:
        assert metric.name.startswith("edge_")
        assert metric.name.endswith("_total") == (metric.kind == "counter")
        assert not metric.name.endswith(("_ms", "_mb", "_ns", "_percent"))
        assert metric.help.endswith(".")


def test_no_text_of_others_is_a_label():
    watched = Watched().watch()
    mission = watched.running.service.mission
    translation = replace(mission.spec.translation, instruction=MISSION)
    mission.spec, mission.target = replace(mission.spec, translation=translation), MISSION
    assert "go to the bed" in watched.running.service.status.instruction
    watched.running.service.error_boundary.on_error("source", ValueError(MISSION), 0)
    page = watched.page()
    assert "xxxx" not in page
    assert 'edge_faults_by_step_total{error="ValueError",step="source"} 1.0' in page


def test_sink_statuses_report_failures_and_drops():
    class Slow:
        def __init__(self, **counts: int) -> None:
            self.status = WorkerStats(**counts).status

    class Wordy:
        def status(self):
            return {"failed": 7, "dropped": "a few", "problem": ""}

    class Broken:
        def status(self):
            raise ValueError("no\nidea")

    sinks = (Slow(failed=2, replaced=3), Wordy(), SimpleNamespace(), Slow(failed=5), Broken())
    found = Watched().watch(*sinks).scrape()
    assert found["edge_sink_failures_total"] == {"Slow": 2, "Slow.2": 5, "Wordy": 7}
    assert found["edge_sink_dropped_total"] == {"Slow": 3, "Slow.2": 0}
    reported = statuses(sinks)
    assert reported["Slow.2"] == {"failed": 5, "dropped": 0, "problem": ""}
    assert reported["Broken"] == {"problem": "status(): ValueError: no idea"}
    assert statuses([]) == {}


def test_checkpoint_metrics_count_writes(tmp_path):
    watched = Watched().watch()
    assert "edge_checkpoint_written_total" not in watched.scrape()
    checkpoint = ServiceCheckpoint(watched.closed.config, tmp_path / "mission.json", None)
    watched.running.service.checkpoint = checkpoint
    watched.closed.step()
    checkpoint.close()
    found = watched.scrape()
    assert found["edge_checkpoint_written_total"] == {(): 1}
    assert found["edge_checkpoint_failed_total"] == {(): 0}


def test_reloads_are_counted_when_they_end():
    watched = Watched().watch()
    running, asked, read = watched.running, threading.Event(), threading.Event()

    def reread():
        read.wait()
        return running.config

    running.reloader = Reloader(running.service, reread, asked)
    watched.vitals.ready()
    asked.set()
    running.reloader.step(0)
    watched.vitals.beat(running)
    found = watched.scrape()
    assert found["edge_service_state"]["reloading"] == 1
    assert sum(found["edge_reloads_total"].values()) == 0
    read.set()
    while running.reloader.busy:
        running.reloader.step(0)
    assert watched.scrape()["edge_reloads_total"] == {"switched": 0, "unchanged": 1, "refused": 0}


def test_metrics_can_be_scraped_while_the_loop_drives():
    watched, stop, failed = Watched().watch(), threading.Event(), []

    def scrape() -> None:
        while not stop.is_set():
            try:
                watched.scrape()
            except Exception as error:
                failed.append(error)

    thread = threading.Thread(target=scrape)
    thread.start()
    for i in range(30):
        watched.closed.step()
        watched.running.source.counters[f"reason {i}"] = i
        watched.running.service.error_boundary.on_error(f"step {i}", ValueError(), 0)
        if i % 10 == 9:
            watched.running.service.on_pose_jump(0)
    stop.set()
    thread.join()
    assert failed == []
    assert watched.scrape()["edge_pose_jumps_total"] == {(): 3}
