"""Dashboard, alerts and their page: a running service reports all that they ask for."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatch
from http.client import HTTPConnection
from pathlib import Path

import pytest
import yaml
from live_patience import PATIENCE_S, eventually
from prometheus_client.parser import text_string_to_metric_families
from simulated import simulated

from edge.cli.commands import run_service
from edge.host.ports import free_port
from edge.host.resources import data_dir
from edge.loop.monitoring.metrics import BOARD_METRICS, HEALTH_METRICS, SERVICE_METRICS
from edge.loop.warmup import warm_up

promql = pytest.importorskip("promql_parser", reason="no wheel of promql-parser for this machine")

CONFIG = data_dir("config")
DASHBOARD = json.loads((CONFIG / "grafana/edge.json").read_text(encoding="utf-8"))
ALERTS = yaml.safe_load((CONFIG / "prometheus/alerts.yaml").read_text(encoding="utf-8"))
RULES = [rule for group in ALERTS["groups"] for rule in group["rules"]]
METRICS = (*HEALTH_METRICS, *SERVICE_METRICS, *BOARD_METRICS)
INSTEAD = {"$__rate_interval": "1m"}
TOLD_BY_PROMETHEUS = {"up": {"job", "instance", "robot"}}
TARGET_LABELS = {"job", "instance", "robot"}


def asked_by_dashboard() -> Iterator[str]:
    for panel in DASHBOARD["panels"]:
        yield from (target["expr"] for target in panel.get("targets", ()))


def plain(expression: str) -> str:
    """Return an expression with values for Grafana's own variables."""
    for name, value in INSTEAD.items():
        expression = expression.replace(name, value)
    return expression


EXPRESSIONS = sorted({*map(plain, asked_by_dashboard()), *(rule["expr"] for rule in RULES)})


def selectors(node) -> Iterator[promql.VectorSelector]:
    """Every selector below a node of a parsed expression."""
    if isinstance(node, promql.VectorSelector):
        yield node
    elif isinstance(node, promql.Call):
        for argument in node.args:
            yield from selectors(argument)
    else:
        for name in ("expr", "lhs", "rhs", "vector_selector", "param"):
            if (below := getattr(node, name, None)) is not None:
                yield from selectors(below)


@pytest.fixture(scope="module")
def reported() -> dict[str, set[str]]:
    """Return the label names of each sample in a scrape of a running service."""
    port, stop = free_port(), threading.Event()
    config = simulated({
        "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}", "shared_memory": False},
        "mission": {"target": "bed"},
        "http": {"port": port},
    })  # fmt: skip

    def ask(path: str) -> tuple[int, str]:
        connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        try:
            connection.request("GET", path)
            answer = connection.getresponse()
            return answer.status, answer.read().decode()
        except OSError:
            return 0, ""
        finally:
            connection.close()

    warm_up(config)  # compilation takes longer than the waits below
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(run_service, config, stop, False, None)
        try:
            eventually(lambda: 'state="running"} 1.0' in ask("/metrics")[1], "it never ran")
            status, page = ask("/metrics")
        finally:
            stop.set()
        assert running.result() == 0
    assert status == 200
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(page):
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    for metric in METRICS:  # one without a series now, as of a missing sensor, is listed too
        if f"# TYPE {metric.name} " in page:
            found.setdefault(metric.name, set(metric.labels))
    return found


def test_there_is_something_to_check():
    assert len(EXPRESSIONS) > 50
    assert len(RULES) > 20


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_expressions_use_only_metrics_of_the_service(reported, expression):
    found = list(selectors(promql.parse(expression)))
    named = set(re.findall(r"\b(?:edge|process)_\w+|\bup\b", expression))
    assert {selector.name for selector in found} == named
    for selector in found:
        assert selector.name in (reported | TOLD_BY_PROMETHEUS)
        labels = reported.get(selector.name, set()) | TARGET_LABELS
        asked = {matcher.name for matcher in selector.matchers.matchers}
        assert asked <= labels


def test_every_other_metric_is_on_the_dashboard():
    asked = {s.name for e in EXPRESSIONS for s in selectors(promql.parse(e))}
    asked = {re.sub(r"_(bucket|count|sum)$", "", name) for name in asked}
    unseen = {metric.name for metric in METRICS} - asked
    assert unseen <= {
        "edge_build_info",  # the dashboard lists robots by it
        "edge_stage_over_budget_total",  # percentiles say it better
        "edge_detector_invalid_boxes_total",
        "edge_mission_elapsed_seconds",
    }


def test_the_dashboard_loads_as_grafana_has_it():
    models = pytest.importorskip(
        "grafana_foundation_sdk.models.dashboard", reason="Grafana's SDK wants Python 3.11"
    )
    loaded = models.Dashboard.from_json(DASHBOARD)
    assert (loaded.uid, loaded.title) == ("edge", "edge")
    assert [p.title for p in loaded.panels] == [p["title"] for p in DASHBOARD["panels"]]
    panels = [panel for panel in DASHBOARD["panels"] if panel["type"] != "row"]
    assert len({panel["id"] for panel in DASHBOARD["panels"]}) == len(DASHBOARD["panels"])
    variables = {variable["name"] for variable in DASHBOARD["templating"]["list"]}
    assert variables == {"datasource", "robot", "instance"}
    for panel in panels:
        assert panel["datasource"]["uid"] == "${datasource}"
        assert panel["targets"], panel["title"]
    cells = {}
    for panel in DASHBOARD["panels"]:
        at = panel["gridPos"]
        for x in range(at["x"], at["x"] + at["w"]):
            for y in range(at["y"], at["y"] + at["h"]):
                assert x < 24
                assert cells.setdefault((x, y), panel["title"]) == panel["title"]


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule["alert"])
def test_every_alert_has_a_severity_and_texts(rule):
    assert re.fullmatch(r"Edge[A-Z][A-Za-z]+", rule["alert"])
    assert rule["labels"]["severity"] in ("critical", "warning", "info")
    notes = rule["annotations"]
    assert set(notes) == {"summary", "description", "runbook"}
    assert "$labels.robot" in notes["summary"]
    assert all(text and "\n" not in text for text in notes.values())


def test_the_page_names_every_metric_and_no_other():
    page = (Path(__file__).parents[1] / "docs/metrics.md").read_text(encoding="utf-8")
    patterns = set(re.findall(r"`(edge_[\w*]+)`", page))
    names = {metric.name for metric in METRICS}
    assert [name for name in names if not any(fnmatch(name, one) for one in patterns)] == []
    assert [one for one in patterns if not any(fnmatch(name, one) for name in names)] == []


def test_the_prometheus_configuration_fits_the_alerts():
    text = (CONFIG / "prometheus/prometheus.yml").read_text(encoding="utf-8")
    config = yaml.safe_load(text)
    assert [CONFIG / "prometheus" / name for name in config["rule_files"]] == [
        CONFIG / "prometheus/alerts.yaml"
    ]
    (job,) = config["scrape_configs"]
    assert job["job_name"] == "edge"  # which alerts ask for
    assert job["authorization"]["credentials_file"] == "edge.token"
    assert all("robot" in robot["labels"] for robot in job["static_configs"])


promtool = pytest.mark.skipif(
    shutil.which("promtool") is None, reason="no promtool (it comes with Prometheus)"
)
RUNS = {'edge_service_state{edge_service_state="running"}': ("1x200", "1x200")}
# By alert: series of a robot that must have it after 45 minutes, and of one that must not.
FIRES = {
    "EdgeDown": {'up{job="edge"}': ("0x200", "1x200")},
    "EdgeRestarts": {'process_start_time_seconds{job="edge"}': ("0+7x200", "5x200")},
    "EdgeLoopHangs": {"edge_loop_beat_age_seconds": ("0+15x200", "0x200"), **RUNS},
    "EdgeBlind": {"edge_observation_age_seconds": ("Inf " * 200, "0.03x200"), **RUNS},
    "EdgeDataWrong": {'edge_check_failed{check="depth_frozen"}': ("1x200", "0x200")},
    "EdgeNotReady": {"edge_service_ready": ("0x200", "1x200"), **RUNS},
    "EdgeLoopDegraded": {"edge_loop_degraded": ("1x200", "0x200")},
    "EdgeFaults": {"edge_faults_total": ("0x150 1x50", "3x200")},
    "EdgeTickOverBudget": {
        'edge_tick_duration_seconds_bucket{le="0.002"}': ("0x200", "0+450x200"),
        'edge_tick_duration_seconds_bucket{le="0.005"}': ("0+450x200", "0+450x200"),
        'edge_tick_duration_seconds_bucket{le="+Inf"}': ("0+450x200", "0+450x200"),
        "edge_tick_budget_seconds": ("0.003x200", "0.003x200"),
    },
    "EdgeDeadlinesMissed": {
        "edge_tick_deadline_missed_total": ("0+9x200", "0+1x200"),
        "edge_tick_duration_seconds_count": ("0+450x200", "0+450x200"),
    },
    "EdgeDetectorSlow": {
        'edge_stage_duration_seconds_bucket{stage="detect",le="0.02"}': ("0x200", "0+450x200"),
        'edge_stage_duration_seconds_bucket{stage="detect",le="0.05"}': ("0+450x200", "0+450x200"),
        'edge_stage_duration_seconds_bucket{stage="detect",le="+Inf"}': ("0+450x200", "0+450x200"),
        'edge_stage_budget_seconds{stage="detect"}': ("0.033x200", "0.033x200"),
    },
    "EdgeMessagesDropped": {
        'edge_source_dropped_total{reason="stale"}': ("0+90x200", "0x200"),
        'edge_source_dropped_total{reason="superseded"}': ("0x200", "0+900x200"),
        "edge_source_received_total": ("0+900x200", "0+900x200"),
    },
    "EdgePoseJumped": {"edge_pose_jumps_total": ("0x150 1x50", "1x200")},
    "EdgeDetectorDegraded": {
        'edge_detector_state{edge_detector_state="degraded"}': ("1x200", "0x200")
    },
    "EdgeModelProcessRestarts": {
        'edge_model_process_restarts_total{model="m"}': ("0+0.1x200", "0x150 1x50")
    },
    "EdgeSteppedDown": {"edge_load_shedding_level": ("1x200", "0x200")},
    "EdgeModelRolledBack": {
        'edge_model_swaps_total{outcome="rolled back"}': ("0x150 1x50", "0x200"),
        'edge_model_swaps_total{outcome="kept"}': ("0x200", "0x150 1x50"),
    },
    "EdgeReloadRefused": {'edge_reloads_total{outcome="refused"}': ("0x150 1x50", "0x200")},
    "EdgeControllerSilent": {
        "edge_controller_answers": ("0x200", "0x200"),
        'edge_goal_state{edge_goal_state="none"}': ("0x200", "1x200"),
    },
    "EdgeGoalOld": {"edge_goal_age_seconds": ("0+15x200", "20x200")},
    "EdgeMissionFailed": {'edge_mission_state{edge_mission_state="failed"}': ("1x200", "0x200")},
    "EdgeSinkFails": {'edge_sink_failures_total{sink="ZenohSink"}': ("0+1x200", "3x200")},
    "EdgeCheckpointFails": {"edge_checkpoint_failed_total": ("0+1x200", "0x200")},
    "EdgeMemoryGrows": {
        'process_resident_memory_bytes{job="edge"}': ("3e8+1000000x200", "3e8x200"),
        'process_start_time_seconds{job="edge"}': ("-9000x200", "-9000x200"),
    },
    "EdgeMemoryLow": {
        'edge_board_memory_bytes{kind="available"}': ("5e8x200", "4e9x200"),
        'edge_board_memory_bytes{kind="total"}': ("8e9x200", "8e9x200"),
    },
    "EdgeFilesLeak": {
        'process_open_fds{job="edge"}': ("900x200", "40x200"),
        'process_max_fds{job="edge"}': ("1024x200", "1024x200"),
    },
    "EdgeHot": {
        'edge_board_temperature_celsius{zone="cpu"}': ("97x200", "60x200"),
        'edge_board_trip_celsius{zone="cpu",trip="passive"}': ("99x200", "99x200"),
    },
    "EdgeThrottled": {'edge_board_throttled_ratio{device="gpu"}': ("0.5x200", "0x200")},
    "EdgeOverCurrent": {'edge_board_over_current_total{alarm="oc3"}': ("0+2x200", "5000x200")},
}


def of_robot(series: str, robot: str) -> str:
    """Return the series with the labels that Prometheus adds to a scrape."""
    name, _, labels = series.rstrip("}").partition("{")
    return f'{name}{{robot="{robot}",instance="{robot}:7480",{labels}}}'


def test_every_alert_is_tried():
    assert list(FIRES) == [rule["alert"] for rule in RULES]


@promtool
def test_every_alert_fires_only_for_its_robot(tmp_path):
    tests = [
        {
            "name": alert,
            "interval": "15s",
            "input_series": [
                {"series": of_robot(series, robot), "values": values[i]}
                for series, values in given.items()
                for i, robot in enumerate(("ill", "well"))
            ],
            "promql_expr_test": [
                {
                    "expr": f'max by (robot) (ALERTS{{alertname="{alert}",alertstate="firing"}})',
                    "eval_time": "45m",
                    "exp_samples": [{"labels": '{robot="ill"}', "value": 1}],
                }
            ],
        }
        for alert, given in FIRES.items()
    ]
    shutil.copy(CONFIG / "prometheus/alerts.yaml", tmp_path)
    data = {"rule_files": ["alerts.yaml"], "evaluation_interval": "15s", "tests": tests}
    (tmp_path / "tests.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    command = ["promtool", "test", "rules", "tests.yaml"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@promtool
def test_prometheus_itself_takes_configuration_and_rules(tmp_path):
    for file in (CONFIG / "prometheus").iterdir():
        shutil.copy(file, tmp_path)
    (tmp_path / "edge.token").touch()
    command = ["promtool", "check", "config", "prometheus.yml"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
