"""The command line: quick help, and errors that are one line with an exit code."""

from __future__ import annotations

import argparse
import errno
import gc
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest
from simulated import simulated

from edge.cli import commands as run_commands
from edge.cli import main as cli
from edge.cli.main import main
from edge.cli.parsers import make_parser
from edge.errors import EXIT_CODES, FAILED, Stopped, UserError
from edge.host.ports import free_port

HEAVY = ("numba", "cv2", "zenoh", "numpy", "onnxruntime", "matplotlib", "pydantic", "mcap")


def commands(parser: argparse.ArgumentParser, words: str = "") -> Iterator[str]:
    yield words
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, part in action.choices.items():
                yield from commands(part, f"{words} {name}".strip())


COMMANDS = tuple(commands(make_parser()))


@pytest.fixture(autouse=True)
def no_signal_handlers(monkeypatch):
    """Commands run in this process must leave its signal handlers alone."""
    monkeypatch.setattr("signal.signal", lambda *_: None)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as caught:
        main([*command.split(), "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert text.startswith(f"usage: edge {command}".rstrip())
    assert all(len(line) < 81 for line in text.splitlines())
    words = " ".join(text.split())
    assert not re.search(r"\(default[^)]*\) \(default|\(default: (None|False|\[\]|)\)", words)


def test_the_help_shows_a_default_without_naming_it(capsys):
    with pytest.raises(SystemExit):
        main(["bench", "--help"])
    assert "how long to measure, in s (default: 60)" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("command", "folder"),
    [
        ("trajectory", "trajectory"), ("demo", "report"), ("soak", "soak"),
        ("eval planning", "planning-report"), ("eval trajectories", "trajectories"),
    ],
)  # fmt: skip
def test_the_help_shows_a_default_folder_as_a_path(command, folder, capsys):
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    assert f"(default: ./{folder})" in " ".join(capsys.readouterr().out.split())


def test_a_command_skips_garbage_collection_at_its_end(capsys, monkeypatch):
    at_the_end = []
    monkeypatch.setattr("atexit.register", at_the_end.append)
    assert main(["config", "demo"]) == 0
    assert at_the_end == [gc.freeze]


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom edge.cli.parsers import make_parser\nimport edge.cli.main\n"
        "make_parser().parse_args(['bench'])\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def fails(capsys, *words: str, code: int) -> str:
    """Return the one-line error of a command."""
    assert main(["--log-level", "error", *words]) == code
    err = capsys.readouterr().err.strip()
    assert "\n" not in err, err
    return err


@pytest.mark.parametrize(
    "command",
    [
        "demo", "run demo --report report", "play nowhere.mcap demo --report report",
        "mission explain bed --draw bed.svg", "eval episodes demo",
        "eval episodes --compare nowhere", "trajectory nowhere straight", "soak",
    ],
)  # fmt: skip
def test_without_the_lab_extra_a_command_names_it_first(command, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    error = fails(capsys, *command.split(), code=os.EX_UNAVAILABLE)
    assert error == (
        "matplotlib: not installed, but needed by this command; run: pip install 'edge-vln[lab]'"
    )


@pytest.mark.parametrize("command", ["run", "demo", "sim", "config", "bench", "doctor"])
def test_a_missing_configuration_lists_the_built_in_ones(command, capsys):
    error = fails(capsys, command, "nowhere.yaml", code=os.EX_CONFIG)
    assert error.startswith("nowhere.yaml: no such file (built-in configurations: ")
    assert "cpu, demo" in error


@pytest.mark.parametrize("words", [("run", "demo"), ("demo", "demo"), ("eval", "episodes", "demo")])
def test_a_report_that_cannot_be_written_fails_before_the_run(words, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    report = str(tmp_path / "file" / "report")
    error = fails(capsys, *words, "--report", report, code=os.EX_IOERR)
    assert "cannot write the report" in error


def test_an_address_in_use_fails_before_the_detector_loads(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("edge.launch.make_detector", None)
    monkeypatch.setattr("edge.launch.warm_up", None)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        path = tmp_path / "mine.yaml"
        detector = {"detector": {"kind": "sim"}}
        path.write_text(json.dumps({"zenoh": {"endpoint": endpoint}, "perception": detector}))
        assert fails(capsys, "run", str(path), code=os.EX_UNAVAILABLE) == (
            f"zenoh.endpoint: {endpoint} is in use: another service runs there; stop it, or set "
            "another port for this one"
        )


def test_a_bench_without_its_model_makes_no_recording(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    said = fails(capsys, "bench", "cpu", code=os.EX_UNAVAILABLE)
    assert "model yolo-world-s-256x320-int8-cpu is not there; run `edge models export" in said
    assert list(tmp_path.rglob("*.mcap*")) == []


def test_a_missing_recording_is_an_error(capsys):
    words = ("bench", "demo", "--recording", "nowhere.mcap")
    assert "no such file" in fails(capsys, *words, code=os.EX_IOERR)


@pytest.mark.parametrize(
    "words",
    [
        ("bench", "--seconds", "0"),
        ("bench", "--seconds", "soon"),
        ("record", "demo", "--out", "x", "--seconds", "nan"),
        ("eval", "episodes", "demo", "--starts", "0"),
        ("eval", "episodes", "demo", "--workers", "-1"),
    ],
)
def test_an_invalid_number_is_a_usage_error(words, capsys):
    with pytest.raises(SystemExit) as caught:
        main(list(words))
    assert caught.value.code == os.EX_USAGE
    assert words[-2] in capsys.readouterr().err


def test_a_target_that_the_world_lacks(capsys):
    error = fails(capsys, "eval", "episodes", "demo", "--targets", "unicorn", code=os.EX_DATAERR)
    assert "unicorn" in error
    assert "television" in error


def test_the_configuration_is_printed_with_the_environment_in_it(capsys, monkeypatch):
    monkeypatch.setenv("EDGE__LOOP__HZ", "12")
    assert main(["config", "demo"]) == 0
    assert json.loads(capsys.readouterr().out)["loop"]["hz"] == 12
    assert main(["config", "--schema"]) == 0
    assert "properties" in json.loads(capsys.readouterr().out)


def test_a_key_in_a_url_is_printed_nowhere(capsys, monkeypatch):
    monkeypatch.setenv("EDGE__MISSION__TRANSLATOR", "{kind: llm, url: 'https://h/v1?key=s3cret'}")
    assert main(["config", "demo"]) == 0
    out = capsys.readouterr().out
    assert json.loads(out)["mission"]["translator"]["url"] == "https://h/v1?***"
    for value in ("['https://h/v1?key=s3cret']", "{url: 'https://h/v1?key=s3cret'"):
        monkeypatch.setenv("EDGE__MISSION__TRANSLATOR__URL", value)
        assert "s3cret" not in fails(capsys, "config", "demo", code=os.EX_CONFIG)


@pytest.mark.parametrize(
    ("options", "policy", "choice", "similarity"),
    [
        ([], "search", "none", None),
        (["--policy", "hvl"], "hvl", "none", None),
        (["--policy", "directional"], "directional", "onnx", None),
        (["--policy", "vlfm"], "vlfm", "none", "mini-house-similarity"),
    ],
)
def test_the_demos_house_has_a_scorer_for_each_policy(
    monkeypatch, options, policy, choice, similarity
):
    for key in [key for key in os.environ if key.startswith("EDGE__")]:
        monkeypatch.delenv(key)
    config = cli.load_config(cli.make_parser().parse_args(["demo", *options]))
    assert config.policy.kind == policy
    assert (config.perception.choice.kind, config.perception.similarity) == (choice, similarity)


@pytest.mark.parametrize(
    ("option", "code"),
    [("--target", os.EX_CONFIG), ("--mission", os.EX_CONFIG), ("--formula", os.EX_DATAERR)],
)
def test_an_empty_mission_is_refused(option, code, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert fails(capsys, "demo", "demo", option, "", code=code)


@pytest.mark.parametrize("command", ["run", "demo"])
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), (None, None, "chair", None, 3)),
        (("--reading", "2"), (None, None, "chair", None, 2)),
        (("--target", "bed"), ("bed", None, "bed", None, 3)),
        (("--mission", "go to the bed"), ("go to the bed", None, "chair", "go to the bed", None)),
        (
            ("--mission", "go to the bed", "--reading", "1"),
            ("go to the bed", None, "chair", "go to the bed", 1),
        ),
        (("--formula", "F bed"), (None, "F bed", "chair", None, 3)),
    ],
)
def test_the_service_gets_the_mission_of_the_command_line(
    command, words, expected, tmp_path, monkeypatch
):
    """A formula leaves the configuration as it is: later orders are read by its translator."""
    opened = []

    def open_service(config, sinks, asked, formula, *_):
        assert config.mission.translator.kind == "auto"
        mission = config.mission
        opened.append((asked, formula, mission.target, mission.instruction, mission.reading))
        raise Stopped

    monkeypatch.setattr("edge.cli.commands.open_service", open_service)
    monkeypatch.setattr("edge.cli.commands.child_processes", lambda *_: nullcontext())
    path = tmp_path / "mine.yaml"
    detector = {"detector": {"kind": "sim"}}
    mission = {"target": "chair", "reading": 3}
    path.write_text(json.dumps({"mission": mission, "perception": detector}))
    assert main([command, str(path), *words, "--report", str(tmp_path / "report")]) == 0
    assert opened == [expected]


@pytest.mark.parametrize(
    ("words", "configured", "is_taken", "served_at"),
    [
        ([], None, False, None),
        (["--live"], None, False, "the usual port"),
        (["--live"], None, True, "another port"),
        (["--live"], 7999, True, 7999),
        (["--live", "7998"], 7999, True, 7998),
    ],
)
def test_the_demos_page_is_at_one_port_and_stays(
    words, configured, is_taken, served_at, tmp_path, monkeypatch, capsys
):
    usual, served = free_port(), []

    def serve(config, stop, options):
        served.append((config.http.port, options.stay))
        raise Stopped

    monkeypatch.setattr(run_commands, "LIVE_PORT", usual)
    monkeypatch.setattr(run_commands, "_serve", serve)
    monkeypatch.setattr(run_commands, "child_processes", lambda *_: nullcontext())
    if configured is not None:
        monkeypatch.setenv("EDGE__HTTP__PORT", str(configured))
    with socket.create_server(("127.0.0.1", usual)) if is_taken else nullcontext():
        assert main(["demo", *words, "--report", str(tmp_path)]) == 0
    ((port, stays),) = served
    assert stays == bool(words)
    if served_at == "another port":
        assert port not in (None, usual)
        assert (
            f"port {usual} is in use, so the page is served on port {port}"
            in capsys.readouterr().err
        )
    else:
        assert port == (usual if served_at == "the usual port" else served_at)


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (["list", "tcp/10.0.0.1:7447#root_ca_private_key_base64=c2VjcmV0"], "zenoh.endpoint"),
        (["router", "tcp/10.0.0.1:7447#root_ca_private_key_base64=c2VjcmV0"], "zenoh.endpoint"),
        (["router", "--file", ""], "zenoh.file"),
    ],
)
def test_a_wrong_router_is_an_error_of_one_line_without_its_secrets(words, key, capsys):
    assert main(["fleet", *words]) == os.EX_CONFIG
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"command line: {key}: ")
    assert "c2VjcmV0" not in line


@pytest.mark.parametrize(
    ("words", "expected"), [([], None), (["--live"], 7999), (["--live", "7998"], 7998)]
)
def test_a_recording_is_shown_only_on_request_and_at_the_configured_port(
    words, expected, tmp_path, monkeypatch
):
    served = []

    def serve(config, *_):
        served.append(config.http.port)
        raise Stopped

    monkeypatch.setattr(run_commands, "_serve", serve)
    monkeypatch.setattr(run_commands, "Playback", lambda *_: nullcontext(MagicMock()))
    monkeypatch.setenv("EDGE__HTTP__PORT", "7999")
    main(["play", str(tmp_path / "robot.mcap"), "demo", *words])
    assert served == [expected]


@pytest.mark.parametrize(
    ("outcome", "code"),
    [
        (0, os.EX_OK),
        (1, FAILED),
        (Stopped(), os.EX_OK),
        (UserError("x"), os.EX_DATAERR),
        (OSError(errno.ENOSPC, "no space left"), os.EX_IOERR),
        (ZeroDivisionError(), os.EX_SOFTWARE),
        (KeyboardInterrupt(), 130),
        (KeyboardInterrupt(signal.SIGTERM), 143),
    ],
)
def test_the_exit_code_reports_how_a_command_ended(outcome, code, monkeypatch, capsys):
    def run_service(*_):
        if isinstance(outcome, int):
            return outcome
        raise outcome

    monkeypatch.setattr("edge.cli.commands.run_service", run_service)
    assert main(["run", "demo"]) == code
    assert code > 128 or code in EXIT_CODES
    assert ("Traceback" in capsys.readouterr().err) == (code == os.EX_SOFTWARE)


@pytest.mark.parametrize(
    ("once", "phase", "code"),
    [(True, "failed", FAILED), (True, "reached", 0), (False, "failed", 0), (False, "reached", 0)],
)
def test_a_stopped_service_does_not_fail_with_its_mission(once, phase, code, monkeypatch):
    mission = SimpleNamespace(phase=phase)
    record = SimpleNamespace(latency=SimpleNamespace(table=str), mission=mission)
    monkeypatch.setattr(run_commands, "_serve", lambda *_: record)
    monkeypatch.setattr(run_commands, "summary", lambda status: status.phase)
    assert run_commands.run_service(simulated(), threading.Event(), once, None) == code


def test_a_closed_output_pipe_is_no_error():
    command = f"{sys.executable} -m edge.cli config --schema | head -c 1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("{", "")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("replay x.mcap --trace --detect", "--detect: not allowed with --trace or --recover"),
        ("mission pause demo anna", "--robots: allowed only with --fleet"),
        ("mission new demo bed --share", "--share: allowed only with --fleet"),
        ("mission new demo bed --task --fleet", "--task: not allowed with --fleet"),
        ("replay x.mcap --out y", "--out: allowed only with --trace or --recover"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words, message, capsys):
    with pytest.raises(SystemExit) as caught:
        main(words.split())
    assert caught.value.code == os.EX_USAGE
    assert capsys.readouterr().err.endswith(f"error: {message}\n")
