"""A configuration is valid, or the error names the wrong key and valid values."""

from __future__ import annotations

import math
from functools import reduce
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from simulated import simulated

from edge import config
from edge.config import (
    UNKNOWN_RADIUS_M,
    Config,
    ConfigError,
    MappingConfig,
    RobotConfig,
    load,
    parse,
)
from edge.config.yaml_text import parse_yaml
from edge.geometry import MIN_FOCAL
from edge.host import resources
from edge.mapping.grid import RollingMap

BUILT_IN = sorted(resources.data_dir("config").glob("*.yaml"))


@pytest.fixture
def write(tmp_path: Path):
    def _write(content: str | bytes) -> str:
        path = tmp_path / "robot.yaml"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return str(path)

    return _write


@pytest.mark.parametrize("content", ["", "# nothing\n", "{}", "---\n", "perception: {}"])
def test_an_empty_file_lacks_nothing_but_its_detector(write, content):
    """The detector must be set: with the simulator's, a real robot sees nothing."""
    path = write(content)
    with pytest.raises(ConfigError) as error:
        load(path, {})
    assert str(error.value) == (
        f"{path}: perception.detector.kind: missing (choices: onnx, sim): set onnx for a robot's "
        "camera; sim finds only objects of the simulator"
    )
    assert load(path, {"EDGE__PERCEPTION__DETECTOR__KIND": "sim"}) == simulated(path=path)


def test_the_schema_requires_the_detector():
    schema = Config.model_json_schema()
    assert schema["required"] == ["perception"]
    assert schema["$defs"]["PerceptionConfig"]["required"] == ["detector"]


@pytest.mark.parametrize("path", BUILT_IN, ids=lambda p: p.stem)
def test_ready_configurations_load_by_path_and_by_name(path):
    assert load(str(path), {}) == load(path.stem, {})


def test_there_are_ready_configurations():
    assert "demo" in [path.stem for path in BUILT_IN]


SIM = {"perception": {"detector": {"kind": "sim"}}}
FAULTS = [
    ({"mision": {}}, "f.yaml: mision: unknown key (did you mean 'mission'?)"),
    ({"robot": {"radius": 1}}, "f.yaml: robot.radius: unknown key (did you mean 'radius_m'?)"),
    ({"robot": {"": 1}}, "f.yaml: robot.'': unknown key (choices: height_m, "),
    (
        {"policy": {"kind": "hvl", "w_dst": 1}},
        "f.yaml: policy.w_dst: unknown key (did you mean 'w_dist'?)",
    ),
    (
        {"perception": {"detector": {"kind": "sim", "miss_rat": 1}}},
        "f.yaml: perception.detector.miss_rat: unknown key (did you mean 'miss_rate'?)",
    ),
    (
        {"perception": {"detector": {"kind": "onnx", "threads": 0}}},
        "f.yaml: perception.detector.threads: input should be greater than or equal to 1, got 0",
    ),
    ({"sim": {"world": {"kind": "mesh", "objects": "x"}}}, "f.yaml: sim.world.mesh: missing"),
    (
        {"sim": {"world": {"kind": "mesh", "mesh": 3, "objects": "x"}}},
        "f.yaml: sim.world.mesh: input should be a valid string, got 3",
    ),
    (
        {"policy": {"kind": "hvll"}},
        "f.yaml: policy.kind: unknown 'hvll' (choices: hvl, vlfm, directional, adaptive, "
        "nearest_frontier, search, module:Class)",
    ),
    (
        {"policy": {"w_dist": 1}},
        "f.yaml: policy.kind: missing (choices: hvl, vlfm, directional, adaptive, "
        "nearest_frontier, search, module:Class)",
    ),
    (
        {"policy": {"kint": "hvl"}},
        "f.yaml: policy.kind: missing, but there is 'kint' (choices: hvl, vlfm, ",
    ),
    ({"sinks": "mcap"}, "f.yaml: sinks: expected a list, got 'mcap'"),
    (
        {"policy": {"kind": "my:b c"}},
        "f.yaml: policy.kind: expected module:Class, such as "
        "my_package.my_module:MyClass, got 'my:b c'",
    ),
    ({"zenoh": {"mode": "x"}}, "f.yaml: zenoh.mode: unknown 'x' (choices: peer, client)"),
    (
        {"zenoh": {"topics": {"camera/rbg": "x"}}},
        "f.yaml: zenoh.topics.camera/rbg: unknown 'camera/rbg' (choices: camera/rgb, camera/depth,",
    ),
    (
        {"zenoh": {"topics": {"odom": "front", "camera/rgb": "front"}}},
        "f.yaml: zenoh.topics: 'front' is the key of both camera/rgb and odom",
    ),
    (
        {"zenoh": {"topics": {"odom": "goal"}}},
        "f.yaml: zenoh.topics: 'goal' is the key of both odom and goal",
    ),
    ({"zenoh": {"topics": {"odom": "a b"}}}, "f.yaml: zenoh.topics.odom: string should match"),
    ({"robot": None}, "f.yaml: robot: expected a section of keys, got None"),
    ({"policy": 3}, "f.yaml: policy: expected a section of keys, got 3"),
    ({"robot": {"radius_m": "wide"}}, "f.yaml: robot.radius_m: "),
    ({"robot": {"radius_m": -1}}, "f.yaml: robot.radius_m: input should be greater than 0, got -1"),
    ({"robot": {"radius_m": float("nan")}}, "f.yaml: robot.radius_m: "),
    ({"robot": {"name": "a b"}}, "f.yaml: robot.name: "),
    ({"mission": {"target": ""}}, "f.yaml: mission.target: "),
    (
        {"mission": {"search_limits_s": 5.0}},
        "f.yaml: mission.search_limits_s: unknown key (did you mean 'search_limit_s'?)",
    ),
    ({"sim": {"start": [1, 2]}}, "f.yaml: sim.start.2: missing"),
    (
        {"perception": {"isolation": "process", "detector": {"kind": "sim"}}},
        "f.yaml: perception: isolation: process needs perception.detector.kind: onnx; the ",
    ),
    (
        {"perception": {**SIM["perception"], "load_shedding": {"levels": [{}]}}},
        "f.yaml: perception.load_shedding.levels.0: set exactly one: model (a",
    ),
    (
        {"perception": {**SIM["perception"], "load_shedding": {"levels": [{"model": "small"}]}}},
        "f.yaml: perception: load_shedding: levels: 0: model: needs perception.detector.kind: "
        "onnx; the detector sim has no model to replace",
    ),
    (
        {"perception": {**SIM["perception"], "load_shedding": {"levels": [{"pause": "choice"}]}}},
        "f.yaml: perception: load_shedding: levels: 0: pause: choice: this scorer is not ",
    ),
    ({"robot": {"radius_m": "0.5"}, "mapping": None}, "f.yaml: mapping: expected a section"),
    ({"robot": {"radius_m": 0.5}, "mapping": []}, "f.yaml: mapping: expected a section"),
    (
        {"robot": {"radius_m": "0.5"}, "mapping": {"extent_m": 12}},
        "f.yaml: mapping: extent_m 12: must be at least 2 * (range_m + 2 * inflation_m) + 1",
    ),
    (
        {"robot": {"height_m": 0.06}},
        "f.yaml: mapping: obstacle_max_m 0.075 (by default from robot.height_m): must be above "
        "obstacle_min_m 0.1",
    ),
    ({"mapping": {"extent_m": 3}}, "f.yaml: mapping: extent_m 3: must be at least 2 * (range_m"),
    (
        {"mapping": {"extent_m": 500, "resolution_m": 0.05}},
        "f.yaml: mapping: extent_m 500 at resolution_m 0.05: more than 4096 cells a side; "
        "set extent_m to at most 204, or resolution_m to at least 0.123",
    ),
    (
        {"perception": {**SIM["perception"], "confirm_hits": 51}},
        "f.yaml: perception.confirm_hits: input should be less than or equal to 50, got 51",
    ),
    (
        {"perception": {**SIM["perception"], "confirm_scores": {"couch": 0.9, "sofa": 0.1}}},
        "f.yaml: perception.confirm_scores: couch and sofa are one name: keep one",
    ),
    (
        {"perception": {"detector": {"kind": "onnx", "background": ["chair", "???"]}}},
        "f.yaml: perception.detector.background.1: ",
    ),
    (
        {"mapping": {"min_range_m": 5, "range_m": 5}},
        "f.yaml: mapping: min_range_m 5: must be below range_m 5, or no measurement is used",
    ),
    (
        {"sensors": {"camera": {"depth_min_m": 9, "depth_max_m": 1}}},
        "f.yaml: sensors.camera: depth_min_m 9: must be below depth_max_m 1",
    ),
    (
        {"mapping": {"resolution_m": 0.032}},
        "f.yaml: mapping.resolution_m: 0.032: too fine for policy.kind hvl, which counts unknown "
        "cells within 1 m: set mapping.resolution_m to at least 0.0323, or another policy.kind",
    ),
    (
        {"sensors": {"camera": {"width_px": 16, "height_px": 4096}}},
        "f.yaml: sensors.camera: hfov_deg 75 at width_px 16, height_px 4096: not a camera: ",
    ),
    (
        {"policy": {"kind": "vlfm"}},
        "f.yaml: policy.kind: vlfm needs the similarity scorer, and none is configured: set "
        "perception.similarity to a card, such as cooccurrence-similarity",
    ),
    (
        {"policy": {"kind": "directional"}},
        "f.yaml: policy.kind: directional needs the choice scorer, and none is configured: set "
        "perception.choice.kind to ",
    ),
    (
        {"policy": {"kind": "adaptive", "by": "choice"}},
        "f.yaml: policy.kind: adaptive needs the choice scorer, and none is configured: set ",
    ),
    (
        {"perception": {**SIM["perception"], "prior": "none", "choice": {"kind": "cooccurrence"}}},
        "f.yaml: perception.choice.kind: cooccurrence needs a prior, and none is configured: set "
        "perception.prior to cooccurrence, rooms or both",
    ),
    (
        {
            "policy": {"kind": "adaptive", "by": "prior"},
            "perception": {**SIM["perception"], "prior": "none"},
        },
        "f.yaml: policy.by: prior needs a prior, and none is configured: set perception.prior",
    ),
    (
        {"http": {"host": "0.0.0.0", "port": 7480}},
        "f.yaml: http: other machines can reach host 0.0.0.0: set token_file (docs/service.md), or",
    ),
    ({"mapping": {"extent_m": 1e9}}, "f.yaml: mapping.extent_m: input should be less than or"),
    (
        {"mission": {"planner": {"kind": "expected", "p_obs": 0.3}}},
        "f.yaml: mission.planner.kind: unknown 'expected' (choices: vitl, in_order, module:Class)",
    ),
    ({1: 2}, "f.yaml: 1: keys should be strings"),
]


SERVER = {"kind": "text", "url": "http://localhost:1", "model": "m"}


@pytest.mark.parametrize(
    ("policy", "perception", "source"),
    [
        ({"kind": "hvl"}, {"similarity": "x", "choice": SERVER}, None),
        ({"kind": "vlfm"}, {"similarity": "x", "choice": SERVER}, "similarity"),
        ({"kind": "directional"}, {"similarity": "x", "choice": SERVER}, "choice"),
        ({"kind": "adaptive"}, {"similarity": "x", "choice": SERVER}, "similarity"),
        ({"kind": "adaptive", "by": "choice"}, {"choice": SERVER}, "choice"),
        ({"kind": "directional"}, {"choice": {"kind": "cooccurrence"}}, "choice"),
        ({"kind": "adaptive", "by": "prior"}, {"choice": SERVER}, None),
        ({"kind": "my:Own"}, {}, None),
        ({"kind": "my:Own"}, {"similarity": "x"}, "similarity"),
        ({"kind": "my:Own"}, {"similarity": "x", "choice": SERVER}, "choice"),
    ],
)
def test_the_policy_decides_the_source_of_value_maps(policy, perception, source):
    assert simulated({"policy": policy, "perception": perception}).value_source == source


@pytest.mark.parametrize(
    "http",
    [
        {"host": "::1", "port": 7480},
        {"host": "0.0.0.0"},  # and no port: nothing listens
        {"host": "0.0.0.0", "port": 7480, "token_file": "/etc/edge/http.token"},
    ],
)
def test_only_open_pages_need_a_token(http):
    assert simulated({"http": http}).http.host == http["host"]


@pytest.mark.parametrize("width_px", [16, 320, 4096])
@pytest.mark.parametrize("height_px", [16, 256, 4096])
@pytest.mark.parametrize("hfov_deg", [10.1, 22.0, 75.0, 149.9])
def test_a_camera_that_is_taken_can_be_simulated(width_px, height_px, hfov_deg):
    data = {
        "sensors": {"camera": {"width_px": width_px, "height_px": height_px, "hfov_deg": hfov_deg}}
    }
    focal = 0.5 * width_px / math.tan(0.5 * math.radians(hfov_deg))
    if focal < MIN_FOCAL * max(width_px, height_px):
        with pytest.raises(ConfigError, match=r"set a smaller hfov_deg, or a wider image$"):
            simulated(data)
    else:
        model = simulated(data).sensors.camera.intrinsics()
        assert (model.width_px, model.height_px) == (width_px, height_px)
        assert model.hfov_rad == pytest.approx(math.radians(hfov_deg))


@pytest.mark.parametrize(
    "key",
    [
        "mission.checkpoint", "mission.site", "perception.similarity",
        *(f"perception.detector.{name}" for name in ("vocabulary", "engine_cache", "fallback")),
    ],
)  # fmt: skip
def test_an_empty_path_or_card_is_refused(key):
    *sections, leaf = key.split(".")
    data = {"perception": {"detector": {"kind": "onnx"}}, "mission": {}}
    reduce(dict.__getitem__, sections, data)[leaf] = ""
    with pytest.raises(ConfigError, match=f"^f.yaml: {key}: string should have at least 1 char"):
        parse(data, "f.yaml")


@pytest.mark.parametrize(("data", "line"), FAULTS, ids=[line[8:40] for _, line in FAULTS])
def test_a_fault_is_one_line_with_its_remedy(data, line):
    with pytest.raises(ConfigError) as error:
        parse({**SIM, **data}, "f.yaml")
    text = str(error.value)
    assert text.startswith(line)
    assert "\n" not in text


def test_hvl_works_with_the_finest_cells_that_its_error_names():
    config = simulated({"mapping": {"resolution_m": 0.0323, "extent_m": 12.0, "range_m": 3.0}})
    share = np.zeros(1, np.float32)
    grid = RollingMap(config.mapping, config.robot)
    grid.unknown.ratio(np.zeros((1, 2), np.float32), 1, UNKNOWN_RADIUS_M, share)
    assert share.tolist() == [1.0]


def test_a_policy_without_unknown_cells_may_have_finer_ones():
    data = {"policy": {"kind": "nearest_frontier"}, "mapping": {"resolution_m": 0.02}}
    assert simulated(data).mapping.resolution_m == 0.02


def test_every_fault_has_its_line():
    with pytest.raises(ConfigError) as error:
        parse({**SIM, "robot": {"radius": 1}, "mision": {}, "zenoh": {"mode": "x"}}, "f.yaml")
    lines = str(error.value).splitlines()
    assert len(lines) == 3
    assert all(line.startswith("f.yaml: ") for line in lines)


def assert_refused(path, says):
    with pytest.raises(ConfigError) as error:
        load(path, {})
    assert str(error.value).startswith(f"{path}: ")
    assert says in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("- 1\n- 2\n", "expected sections"),
        ("hello", "expected sections"),
        ("robot: {", "not YAML"),
        (b"\x00\x01\xff\xfe\x80binary", "not YAML"),
        ("loop: {hz: 2024-13-45}", "not YAML: month must be in 1..12"),
        ("[" * 1000, "nested too deeply (more than 64 levels)"),
        ("loop: {hz: !!timestamp soon}", "not YAML: a value does not fit its tag"),
        ("loop: {hz: !!int ''}", "not YAML"),
    ],
)
def test_an_invalid_configuration_file_is_refused(write, content, says):
    assert_refused(write(content), says)


def nested(first: str, more: str) -> str:
    """YAML in which each line stands for nine of the line before, nine times over."""
    return first + "".join(
        more.format(name=name, nine=", ".join(["*" + before] * 9))
        for before, name in pairwise("abcdefghij")
    )


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (nested("a: &a [x, x]\n", "{name}: &{name} [{nine}]\n"), "more than 20000 keys and values"),
        (nested("a: &a {x: 1}\n", "{name}: &{name} {{<<: [{nine}]}}\n"), "more than 20000"),
        ("robot: &a\n  name: [*a]", "line 2: an alias (*name) is inside the value"),
        ("".join(f"- &a{i + 1} [*a{i}]\n" for i in range(1, 99)), "undefined alias 'a1'"),
        ("- &a0 x\n" + "".join(f"- &a{i + 1} [*a{i}]\n" for i in range(99)), "nested too deeply"),
        ("{a: " * 100, "nested too deeply"),
        ("? " * 1000, "nested too deeply"),
        ("".join(" " * i + "a:\n" for i in range(100)), "nested too deeply"),
        ("loop: {hz: 1" + ":1" * 100_000 + "}", "line 1: a number of more than 100 characters"),
        ("a" * ((1 << 20) + 1), "Longer than 1048576 bytes"),
        ("robot:\n  name: a\n  radius_m: 1\n  name: b", "line 4: robot.name: given twice, first in"
         " line 2: keep one"),
        ("1: 1\n0x1: 2", "line 2: 0x1: given twice, first in line 1"),
        ("a: &a {x: 1}\nb:\n  <<: *a\n  <<: *a", "line 4: b.<<: given twice, first in line 3"),
    ],
)  # fmt: skip
def test_absurd_yaml_is_refused_at_once(write, content, says):
    assert_refused(write(content), says)


def test_a_yaml_alias_may_be_reused(write):
    content = """
    x: &sim {kind: sim, miss_rate: 0.2}
    perception: {detector: {<<: *sim, miss_rate: 0.3}}
    """
    with pytest.raises(ConfigError, match=r"x: unknown key") as error:
        load(write(content), {})
    assert "\n" not in str(error.value)
    assert parse_yaml(content)["perception"] == {"detector": {"kind": "sim", "miss_rate": 0.3}}


def test_all_yaml_is_read_by_one_reader():
    package = Path(config.__file__).parents[1]
    text = {p: p.read_text(encoding="utf-8") for p in package.rglob("*.py")}
    assert [p.name for p in text if "SafeLoader" in text[p]] == ["yaml_text.py"]
    assert [p for p in text if "yaml.safe_load" in text[p] or "yaml.load" in text[p]] == []


def test_huge_values_are_cut_in_errors(write):
    """Only the shown part of a value is formatted."""
    for value in ("[" + "x, " * 1500 + "]", "x" * 90_000, "[" * 60 + "]" * 60):
        with pytest.raises(ConfigError) as error:
            load(write(f"robot: {{name: {value}}}"), {})
        assert max(map(len, str(error.value).splitlines())) < 400


def test_only_the_first_faults_are_reported():
    with pytest.raises(ConfigError) as error:
        parse({**SIM, "sinks": [3] * 1000}, "f.yaml")
    lines = str(error.value).splitlines()
    assert len(lines) == 21
    assert lines[-1] == "f.yaml: 980 more faults"


def test_a_missing_file_lists_the_built_in_ones():
    with pytest.raises(ConfigError) as error:
        load("no/such/file.yaml", {})
    assert str(error.value).startswith("no/such/file.yaml: no such file")
    assert "demo" in str(error.value)


def test_a_folder_is_not_a_configuration(tmp_path):
    with pytest.raises(ConfigError, match=str(tmp_path)):
        load(str(tmp_path), {})


OVERRIDES = [
    ({}, lambda c: c.robot_name, "edge"),
    ({"EDGE__ZENOH__PREFIX": "robots/anna"}, lambda c: c.robot_name, "anna"),
    (
        {"EDGE__ZENOH__PREFIX": "robots/anna", "EDGE__ROBOT__NAME": "Rosie"},
        lambda c: c.robot_name,
        "Rosie",
    ),
    ({"EDGE__ROBOT__RADIUS_M": "0.3"}, lambda c: c.robot.radius_m, 0.3),
    ({"EDGE__ROBOT__RADIUS_M": "0.3"}, lambda c: c.mapping.inflation_m, 0.3),
    ({"EDGE__ROBOT__RADIUS_M": "5e-1"}, lambda c: c.mapping.inflation_m, 0.5),
    ({"EDGE__ROBOT": "{radius_m: '0.5'}"}, lambda c: c.mapping.inflation_m, 0.5),
    ({"EDGE__ROBOT": "{radius_m: '0.5'}"}, lambda c: c.tasks.trajectory.clearance_m, 0.6),
    (
        {"EDGE__ROBOT": "{radius_m: '0.5'}", "EDGE__TASKS__TRAJECTORY": "{max_jump_m: 9}"},
        lambda c: (c.tasks.trajectory.clearance_m, c.tasks.trajectory.max_jump_m),
        (0.6, 9),
    ),
    ({"EDGE__ROBOT__RADIUS_M": "0.1"}, lambda c: c.mapping.inflation_m, 0.2),
    (
        {"EDGE__ROBOT__RADIUS_M": "0.3", "EDGE__MAPPING__INFLATION_M": "0.3"},
        lambda c: c.mapping.inflation_m,
        0.3,
    ),
    ({"EDGE__ROBOT__RADIUS_M": "0.5"}, lambda c: c.tasks.trajectory.clearance_m, 0.6),
    ({"EDGE__ROBOT__RADIUS_M": "0.1"}, lambda c: c.tasks.trajectory.clearance_m, 0.3),
    (
        {"EDGE__ROBOT__RADIUS_M": "0.5", "EDGE__TASKS__TRAJECTORY__CLEARANCE_M": "0.5"},
        lambda c: c.tasks.trajectory.clearance_m,
        0.5,
    ),
    ({"EDGE__ROBOT__HEIGHT_M": "0.8"}, lambda c: c.mapping.obstacle_max_m, 1.0),
    ({"EDGE__ROBOT__HEIGHT_M": "1.5"}, lambda c: c.mapping.obstacle_max_m, 1.7),
    ({"EDGE__ROBOT__HEIGHT_M": "0.3"}, lambda c: c.mapping.obstacle_max_m, 0.375),
    (
        {"EDGE__ROBOT__HEIGHT_M": "0.3", "EDGE__MAPPING__OBSTACLE_MAX_M": "0.9"},
        lambda c: c.mapping.obstacle_max_m,
        0.9,
    ),
    ({"EDGE__SENSORS__LIDAR": "{z_m: -0.047}"}, lambda c: c.sensors.lidar.z_m, -0.047),
    ({"EDGE__SENSORS__CAMERA__Z_M": "0"}, lambda c: c.sensors.camera.z_m, 0.0),
    ({}, lambda c: c.robot.self_filter_m, 0.2),
    ({"EDGE__ROBOT__RADIUS_M": "0.3"}, lambda c: c.robot.self_filter_m, 0.3),
    ({"EDGE__ROBOT__SELF_FILTER_M": "0"}, lambda c: c.robot.self_filter_m, 0.0),
    ({"EDGE__POLICY__KIND": "nearest_frontier"}, lambda c: c.policy.kind, "nearest_frontier"),
    ({"EDGE__LOOP__LOCKSTEP": "true"}, lambda c: c.loop.lockstep, True),
    ({"EDGE__SENSORS__CAMERA__WIDTH_PX": "64"}, lambda c: c.sensors.camera.width_px, 64),
    ({"EDGE__SIM__START": "[1, 2, 0.5]"}, lambda c: c.sim.start, (1.0, 2.0, 0.5)),
    ({"EDGE__SENSORS__LIDAR": "{rings: 1}"}, lambda c: c.sensors.lidar.rings, 1),
    ({"EDGE_ROBOT_RADIUS_M": "9", "OTHER": "1"}, lambda c: c.robot.radius_m, 0.2),
    ({}, lambda c: c.mission.target, "sofa"),
    ({"EDGE__MISSION__TARGET": "bed"}, lambda c: c.mission.target, "bed"),
]


@pytest.mark.parametrize(("environ", "read", "value"), OVERRIDES)
def test_environment_overrides(write, environ, read, value):
    given = yaml.safe_dump({**SIM, "mission": {"target": "sofa"}})
    assert read(load(write(given), environ)) == value


@pytest.mark.parametrize(
    ("environ", "says"),
    [
        ({"EDGE__ROBOT__RADIUS": "0.3"}, "robot.radius: unknown key"),
        (
            {"EDGE__ROBOT__RADIUS_M": "{"},
            "environment EDGE__ROBOT__RADIUS_M: cannot be read as YAML",
        ),
        (
            {"EDGE__LOOP__HZ": "2024-13-45"},
            "environment EDGE__LOOP__HZ: cannot be read as YAML: '2024",
        ),
        ({"EDGE__LOOP__HZ": "[" * 1000}, "environment EDGE__LOOP__HZ: nested too deeply"),
    ],
)
def test_a_wrong_override_is_an_error(write, environ, says):
    with pytest.raises(ConfigError, match=says):
        load(write(""), environ)


BY = "environment EDGE__"


@pytest.mark.parametrize(
    ("environ", "named"),
    [
        ({"LOOP__HZ": "fast"}, f"{BY}LOOP__HZ: loop.hz: input should be a valid number"),
        ({"POLICY": "{kind: hvll}"}, f"{BY}POLICY: policy.kind: unknown 'hvll'"),
        ({"POLICY__KIND": "hvll"}, f"{BY}POLICY__KIND: policy.kind: unknown 'hvll'"),
        ({"MISION__TARGET": "bed"}, f"{BY}MISION__TARGET: mision: unknown key (did you mean"),
        ({"ROBOT__RADIUS": "1"}, f"{BY}ROBOT__RADIUS: robot.radius: unknown key"),
        ({"SINKS": "[{knd: a}]"}, f"{BY}SINKS: sinks.0.kind: missing"),
        # The file and the environment are at fault together.
        ({"SIM__WORLD__KIND": "mesh"}, f"FILE, {BY}SIM__WORLD__KIND: sim.world.mesh: missing"),
        ({"POLICY__KIND": "vlfm"}, f"{BY}POLICY__KIND, FILE: policy.kind: vlfm needs"),
        (
            {"POLICY": "{kind: adaptive, by: prior}", "PERCEPTION__PRIOR": "none"},
            f"{BY}POLICY, {BY}PERCEPTION__PRIOR: policy.by: prior needs a prior, and none",
        ),
        ({"ROBOT__NAME": "a"}, "FILE: robot.radius_m: "),
    ],
)
def test_an_error_names_the_source_of_the_key(write, environ, named):
    """The error does not name the file if the environment set the key."""
    broken = "ROBOT__NAME" in environ
    robot = {"robot": {"radius_m": "wide"}} if broken else {}
    path = write(yaml.safe_dump({**SIM, **robot}))
    with pytest.raises(ConfigError) as error:
        load(path, {f"EDGE__{key}": value for key, value in environ.items()})
    assert str(error.value).splitlines()[0].startswith(named.replace("FILE", path))


def test_variables_that_nothing_reads_are_reported_once(write, caplog):
    unread = ("EDGE_FOO", "EDGE_POLICY__KIND", "edge__loop__hz", "EDGE_VOCABULARIES")
    read = ("EDGE_CACHE_DIR", "EDGE_VOCABULARY", "EDGE_TRUST_CACHE", "EDGE__LOOP__HZ")
    environ = dict.fromkeys((*unread, *read, "KNOWLEDGE_BASE", "LEDGER__A"), "3")
    for _ in range(2):
        load(write(yaml.safe_dump(SIM)), environ)
    assert [record.getMessage() for record in caplog.records] == [
        "environment variable EDGE_FOO is not used: EDGE__SECTION__KEY sets a key",
        "environment variable EDGE_POLICY__KIND is not used: did you mean EDGE__POLICY__KIND?",
        "environment variable EDGE_VOCABULARIES is not used: did you mean EDGE_VOCABULARY?",
        "environment variable edge__loop__hz is not used: did you mean EDGE__LOOP__HZ?",
    ]


def test_objects_derive_the_same_clearances_as_a_file():
    """This holds for sections given as objects too."""
    made = Config(
        perception=SIM["perception"],
        robot=RobotConfig(radius_m=0.5),
        mapping=MappingConfig(range_m=3.0),
    )
    assert (made.mapping.inflation_m, made.mapping.range_m) == (0.5, 3.0)
    assert made.tasks.trajectory.clearance_m == 0.6


def test_a_dumped_configuration_loads_as_itself(write):
    for path in BUILT_IN:
        loaded = load(str(path), {})
        again = load(write(loaded.model_dump_json(exclude={"path"})), {})
        assert again.model_dump(exclude={"path"}) == loaded.model_dump(exclude={"path"})


def test_every_key_of_the_built_in_files_is_used():
    """A built-in file lists only differences from the defaults, in existing keys."""
    for path in BUILT_IN:
        assert set(yaml.safe_load(path.read_text())) <= set(config.Config.model_fields)
