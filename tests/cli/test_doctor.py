"""`edge doctor`: each problem is named with a remedy, and fails only its dependants."""

from __future__ import annotations

import argparse
import json
import re
import socket
import sys
from importlib import metadata
from types import SimpleNamespace

import numpy as np
import pytest
from packaging.requirements import Requirement
from patience import PATIENCE_S
from simulated import simulated

from edge import config
from edge.bus.session import open_session
from edge.cli import bus_checks, doctor, machine_checks, model_checks, onnx_probe
from edge.cli.findings import Check, Finding
from edge.cli.onnx_probe import CPU, CUDA
from edge.cli.parsers import make_parser
from edge.host import calibration, machine, resources
from edge.host.ports import free_port

SIM = simulated()
ONNX = simulated({"perception": {"detector": {"kind": "onnx", "model": "made-up"}}})
TENSORRT = simulated(
    {"perception": {"detector": {"kind": "onnx", "model": "made-up", "providers": ["tensorrt"]}}}
)

ORIN = "# R36 (release), REVISION: 4.3, GCID: 1"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("EDGE_VOCABULARY", raising=False)
    return tmp_path / "cache"


def levels(check: Check, settings: config.Config = SIM) -> list[str]:
    return [finding.level for finding in check(settings)]


def command(*words: str) -> argparse.Namespace:
    return make_parser().parse_args(["doctor", *words])


def test_no_findings():
    assert doctor.as_text([]) == "0 ok, 0 warn, 0 fail"
    assert json.loads(doctor.as_json([])) == {"ok": True, "findings": []}


def test_this_machine_runs_the_embedded_default(capsys):
    args = command("--json")
    code = args.handler(args)
    answer = json.loads(capsys.readouterr().out)
    assert code == (0 if answer["ok"] else 1)
    assert answer["ok"], [f for f in answer["findings"] if f["level"] == "fail"]
    assert all(f["todo"] for f in answer["findings"] if f["level"] != "ok")


@pytest.mark.parametrize(("level", "code"), [("ok", 0), ("warn", 0), ("fail", 1)])
def test_only_a_failure_gives_exit_code_1(monkeypatch, capsys, level, code):
    finding = Finding(level, "a part", "do this")
    monkeypatch.setattr(doctor, "CHECKS", (lambda _: iter([finding]),))
    args = command()
    assert args.handler(args) == code
    assert capsys.readouterr().out.splitlines()[0] == f"{level:4}  a part — do this"


def test_a_check_that_breaks_is_a_finding(monkeypatch):
    def check_the_weather(_):
        raise RuntimeError("two\nlines")

    monkeypatch.setattr(doctor, "CHECKS", (check_the_weather,))
    (finding,) = doctor.examine(SIM)
    assert (finding.level, finding.what) == (
        "fail",
        "check of the weather crashed: RuntimeError: two lines",
    )


@pytest.mark.parametrize(
    ("version", "level"), [((3, 9), "fail"), ((3, 10), "ok"), ((3, 13), "ok"), ((3, 14), "fail")]
)
def test_python(monkeypatch, version, level):
    monkeypatch.setattr(machine_checks.sys, "version_info", version)
    assert levels(machine_checks.check_python) == [level]


def test_the_doctor_reports_the_speed_of_this_computer(cache):
    (unknown,) = machine_checks.check_speed(SIM)
    assert (unknown.level, "edge bench --calibrate" in unknown.todo) == ("warn", True)
    cache.mkdir()
    calibration.save(calibration.SpeedCalibration(machine.identity(), 1.8, {}))
    (known,) = machine_checks.check_speed(SIM)
    assert known == Finding(
        "ok", f"speed of {machine.identity()}: 1.8 times slower than the reference computer"
    )


def test_a_package_that_cannot_be_loaded(monkeypatch):
    monkeypatch.setattr(machine_checks, "CORE_MODULES", ("numpy", "no_such_module"))
    failed, found = machine_checks.check_packages(SIM)
    assert (failed.level, found.level) == ("fail", "ok")
    assert "no_such_module" in failed.what


def test_only_packages_that_every_robot_has_are_needed():
    """An installation with `[cpu]` alone fails no check."""
    required = [Requirement(line) for line in metadata.requires("edge-vln") or ()]
    always = {of.name for of in required if of.marker is None}
    packages = metadata.packages_distributions()
    assert all(always & set(packages[module]) for module in machine_checks.CORE_MODULES)


@pytest.mark.parametrize(
    ("installed", "expected"),
    [
        ([], []),
        (["opencv-python-headless"], []),
        (
            ["opencv-python-headless", "opencv-python"],
            [
                "opencv-python-headless and opencv-python overwrite each other's files — pip "
                "uninstall opencv-python-headless opencv-python, then pip install "
                "opencv-python-headless"
            ],
        ),
    ],
)
def test_packages_of_opencv_that_overwrite_each_other(monkeypatch, installed, expected):
    def find(name):
        if name not in installed:
            raise machine_checks.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(machine_checks.metadata, "distribution", find)
    assert [f"{f.what} — {f.todo}" for f in machine_checks.check_opencv(SIM)] == expected


@pytest.mark.parametrize(("cores", "level"), [(1, "warn"), (2, "ok")])
def test_cores(monkeypatch, cores, level):
    monkeypatch.setattr(machine_checks.os, "sched_getaffinity", lambda _: set(range(cores)))
    assert levels(machine_checks.check_cores) == [level]


@pytest.mark.parametrize(
    ("release", "fault", "settings", "expected"),
    [
        (None, "not available", SIM, []),
        (ORIN, "not available", ONNX, ["warn"]),
        (ORIN, "", ONNX, ["ok"]),
        (ORIN, "not available", TENSORRT, ["ok"]),
    ],
)
def test_jetson(monkeypatch, tmp_path, release, fault, settings, expected):
    path = tmp_path / "nv_tegra_release"
    if release is not None:
        path.write_text(release)
    monkeypatch.setattr(machine_checks, "TEGRA_RELEASE", path)
    monkeypatch.setattr(machine_checks, "fault_of", {CUDA: fault}.get)
    findings = list(machine_checks.check_jetson(settings))
    assert [f.level for f in findings] == expected
    assert all("R36 (release), REVISION: 4.3" in f.what for f in findings)


def test_shared_memory(monkeypatch, tmp_path):
    assert list(machine_checks.check_shared_memory(SIM)) == []
    used = simulated({"zenoh": {"shared_memory": True}})
    usage = machine_checks.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(machine_checks, "SHM", tmp_path)
    for size_mb, level in ((63, "warn"), (64, "ok")):
        total = size_mb << 20
        monkeypatch.setattr(
            machine_checks.shutil, "disk_usage", lambda _, t=total: usage._replace(total=t)
        )
        assert levels(machine_checks.check_shared_memory, used) == [level]
    monkeypatch.setattr(machine_checks, "SHM", tmp_path / "none")
    assert levels(machine_checks.check_shared_memory, used) == ["warn"]


def test_a_cache_that_cannot_be_written(cache):
    assert levels(machine_checks.check_cache) == ["ok"]
    assert list(cache.iterdir()) == []
    cache.rmdir()
    cache.write_text("a file in the way")
    (finding,) = machine_checks.check_cache(SIM)
    assert finding.level == "warn"
    assert "EDGE_CACHE_DIR" in finding.todo


def test_no_message_over_zenoh(monkeypatch):
    assert bus_checks.loopback_ms(PATIENCE_S) > 0
    monkeypatch.setattr(bus_checks, "loopback_ms", lambda _: None)
    (finding,) = bus_checks.check_zenoh(SIM)
    assert finding.level == "fail"
    assert "127.0.0.1" in finding.todo


def test_an_endpoint_that_is_taken():
    settings = simulated({"zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"}})
    assert levels(bus_checks.check_endpoint, settings) == ["ok"]
    with open_session(settings.zenoh, "listen"):
        assert levels(bus_checks.check_endpoint, settings) == ["warn"]


def test_the_doctor_warns_of_open_endpoints_and_readable_passwords(tmp_path):
    assert levels(bus_checks.check_access) == []
    open_ = simulated({"zenoh": {"endpoint": "tcp/0.0.0.0:7447"}})
    (finding,) = bus_checks.check_access(open_)
    assert finding.level == "warn"
    assert finding.what.startswith(
        "tcp/0.0.0.0:7447 is open: every client that reaches it may command"
    )
    users = tmp_path / "users.txt"
    users.write_text("operator:of the operator\n")
    users.chmod(0o644)
    file = tmp_path / "service.json5"
    file.write_text(f'{{transport: {{auth: {{usrpwd: {{dictionary_file: "{users}"}}}}}}}}')
    shut = simulated({"zenoh": {"endpoint": "tcp/0.0.0.0:7447", "file": str(file)}})
    (finding,) = bus_checks.check_access(shut)
    assert (finding.level, finding.todo) == ("warn", f"chmod o= {users}")
    users.chmod(0o600)
    assert levels(bus_checks.check_access, shut) == []


def test_rules_for_another_prefix_give_a_warning():
    rules = str(resources.data_dir("config") / "secure" / "service.json5")
    for prefix, expected in {"edge": [], "robots/a": ["warn"]}.items():
        settings = simulated({"zenoh": {"file": rules, "prefix": prefix}})
        assert levels(bus_checks.check_access, settings) == expected


def test_the_token_of_the_pages_is_looked_at(tmp_path):
    token = tmp_path / "token"
    settings = simulated({"http": {"token_file": str(token)}})
    assert [f.level for f in doctor.examine(settings) if str(token) in f.what] == ["fail"]
    token.write_text("0123456789abcdef")
    token.chmod(0o604)
    (finding,) = bus_checks.check_access(settings)
    assert (finding.level, finding.todo) == ("warn", f"chmod o= {token}")
    token.chmod(0o600)
    assert levels(bus_checks.check_access, settings) == []


def test_an_unusable_zenoh_file_is_reported_once():
    settings = simulated({"zenoh": {"file": "gone.json5"}})
    findings = [f for f in doctor.examine(settings) if "gone.json5" in f.what]
    assert [finding.level for finding in findings] == ["fail"]


@pytest.mark.parametrize(
    ("installed", "faults", "available", "settings", "expected"),
    [
        ((), {}, (), SIM, ["warn"]),
        ((), {}, (), TENSORRT, ["warn"]),
        (("onnxruntime",), {}, ("Other",), ONNX, ["ok", "fail"]),
        (("onnxruntime", "onnxruntime-gpu"), {}, (CPU,), SIM, ["warn", "ok"]),
        (("onnxruntime",), {CPU: "crashes"}, (CPU,), SIM, ["warn"]),
        (("onnxruntime",), {CPU: "crashes"}, (CPU,), ONNX, ["fail"]),
        (("onnxruntime-gpu",), {CUDA: "no kernel image"}, (CUDA, CPU), ONNX, ["ok", "warn"]),
        (("onnxruntime-gpu",), {}, (CUDA, CPU), ONNX, ["ok"]),
    ],
)
def test_onnxruntime(monkeypatch, installed, faults, available, settings, expected):
    module = SimpleNamespace(get_available_providers=lambda: available)
    monkeypatch.setitem(sys.modules, "onnxruntime", module)
    monkeypatch.setattr(model_checks, "find_spec", lambda _: module if installed else None)
    monkeypatch.setattr(model_checks, "is_installed", lambda package: package in installed)
    monkeypatch.setattr(model_checks.metadata, "version", lambda _: "1.23")
    monkeypatch.setattr(model_checks, "fault_of", lambda provider: faults.get(provider, ""))
    findings = list(model_checks.check_onnxruntime(settings))
    assert [finding.level for finding in findings] == expected
    assert all(finding.todo for finding in findings if finding.level != "ok")


def test_a_crashing_onnxruntime_is_reported_in_one_line(monkeypatch):
    """And nothing that would have it crash in this process is tried after that."""
    pytest.importorskip("onnxruntime")
    fault = "its process: ended by SIGSEGV before it was ready"
    monkeypatch.setattr(onnx_probe, "fault_of", lambda _: fault)
    monkeypatch.setattr(model_checks, "fault_of", lambda _: fault)
    crashing = ("check_onnxruntime", "check_configuration", "check_background")
    checks = [check for check in doctor.CHECKS if check.__name__ in crashing]
    monkeypatch.setattr(doctor, "CHECKS", checks)
    uses_it_twice = simulated(
        {
            "perception": {
                "detector": {"kind": "onnx", "model": "mini-house-256x320-int8-cpu"},
                "similarity": "mini-house-similarity",
            }
        }
    )
    (finding,) = doctor.examine(uses_it_twice)
    assert re.fullmatch(rf"onnxruntime [\d.]+: {fault}", finding.what)
    assert "docs/install.md" in finding.todo
    _, finding = doctor.examine(simulated({"sinks": ["zenho"]}))
    assert (finding.level, "zenho" in finding.what) == ("fail", True)


def test_tensorrt(monkeypatch):
    assert levels(model_checks.check_tensorrt, ONNX) == []
    monkeypatch.setitem(sys.modules, "tensorrt", None)  # not to be had
    (finding,) = model_checks.check_tensorrt(TENSORRT)
    assert (finding.level, "JetPack" in finding.todo) == ("fail", True)
    monkeypatch.setitem(sys.modules, "tensorrt", SimpleNamespace(__version__="10.3.0"))
    monkeypatch.setattr(model_checks.cuda, "Device", lambda index: None)
    assert levels(model_checks.check_tensorrt, TENSORRT) == ["ok"]


def test_absent_unused_models_are_only_counted(cache):
    """Models of the package are present; a similarity card has no file."""
    *here, others = model_checks.check_models(SIM)
    assert {f.level for f in (*here, others)} == {"ok"}
    assert re.match(r"\d+ other models are not on this machine", others.what)
    assert not any("similarity" in f.what for f in here)
    broken = cache / "models" / "yolo-world-s-256x320-fp32.onnx"
    broken.parent.mkdir(parents=True)
    broken.write_bytes(b"")
    (finding,) = (f for f in model_checks.check_models(SIM) if f.level != "ok")
    assert (finding.level, str(broken) in finding.what) == ("warn", True)


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({}, []),
        ({"sinks": ["zenho"]}, ["sinks.0.kind: unknown 'zenho'"]),
        (
            {"mission": {"target": "bed", "translator": {"kind": "model", "card": "nonsense"}}},
            ["mission.translator.card: model 'nonsense'"],
        ),
        (
            {"perception": {"detector": {"kind": "onnx", "model": "made-up"}}},
            ["perception.detector.model: model 'made-up'"],
        ),
        (
            {"sinks": ["zenho"], "perception": {"similarity": "made-up"}},
            ["sinks.0.kind", "perception.similarity: model 'made-up'"],
        ),
    ],
)
def test_the_configuration_is_checked_as_for_a_run(sections, says):
    """Each fault is one finding."""
    checks = (doctor.check_configuration, model_checks.check_models)
    found = [f for check in checks for f in check(simulated(sections)) if f.level != "ok"]
    assert [f.level for f in found] == ["fail"] * len(says)
    assert all(words in f.what and f.todo for words, f in zip(says, found, strict=True))


def test_vocabulary(monkeypatch, tmp_path):
    path = tmp_path / "words.npz"
    np.savez(path, names=np.array(["chair"]), emb=np.ones((1, 512), np.float16))
    monkeypatch.setenv("EDGE_VOCABULARY", str(path))
    detector = {"kind": "onnx", "model": "yolo-world-s-256x320-int8-cpu"}
    for target, level in (("chair", "ok"), ("zebra crossing", "fail")):
        settings = simulated({"perception": {"detector": detector}, "mission": {"target": target}})
        assert levels(doctor.check_mission, settings) == [level]
        assert levels(model_checks.check_background, settings) == []
    detector["background"] = ["zebra", "chair", "heron"]
    settings = simulated({"perception": {"detector": detector}, "mission": {"target": "chair"}})
    (unknown,) = model_checks.check_background(settings)
    assert unknown.level == "warn"
    assert "does not know 2 of the 3 words of perception.detector.background" in unknown.what
    assert "zebra, heron" in unknown.todo


def test_the_server_of_a_choice_scorer_is_checked():
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"http://127.0.0.1:{server.getsockname()[1]}/v1"
        settings = simulated(
            {"perception": {"choice": {"kind": "openai", "url": url, "model": "m"}}}
        )
        assert levels(model_checks.check_choice_server, settings) == []
    (finding,) = model_checks.check_choice_server(settings)
    assert (finding.level, url in finding.what) == ("warn", True)


@pytest.mark.parametrize(
    ("mission", "level", "words"),
    [
        ({"target": "bed"}, "ok", "F bed"),
        ({"instruction": "go to the bed, then to the tv"}, "ok", "then the television"),
        ({"instruction": "go to the bed and never go to the bed"}, "fail", "contradiction"),
        ({"target": "bed", "checkpoint": "/no/such/folder/mission.json"}, "fail", "checkpoint"),
    ],
)
def test_the_mission_is_checked(mission, level, words):
    settings = simulated({"mission": mission})
    (finding,) = doctor.check_mission(settings)
    assert finding.level == level
    assert words in finding.what
    assert finding.todo or level == "ok"
