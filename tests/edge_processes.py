"""`edge` commands as processes, started and looked after by tests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from live_patience import PATIENCE_S

from edge.cli.main import main
from edge.host.ports import free_port

# Only a failing test waits this long: for a mission to end, and for a process that should end,
# which first writes its report.
MISSION_S = 600.0
STOP_S = PATIENCE_S

# As fast as the machine can, and the same on a slow one.
LOCKSTEP = {"EDGE__LOOP__LOCKSTEP": "true", "EDGE__SIM__LOCKSTEP": "true"}
LOCKED = {"loop": {"lockstep": True}, "sim": {"lockstep": True, "step_s": 0.2}}


class Edge:
    """One `edge` command; its output is read as it comes."""

    def __init__(self, *arguments: object, cwd: Path, **environ: str) -> None:
        command = [sys.executable, "-m", "edge.cli", *map(str, arguments)]
        self.process = subprocess.Popen(
            command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env={**os.environ, "XDG_STATE_HOME": str(cwd), **environ}, start_new_session=True,
        )  # fmt: skip
        self.lines: list[str] = []
        self._family: dict[int, psutil.Process] = {}
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    @property
    def output(self) -> str:
        return "\n".join(self.lines)

    def says(self, text: str) -> Edge:
        """Wait until the output contains this text."""
        self.until(lambda: text in self.output, f"never said {text!r}")
        return self

    def until(self, what: Callable[[], object], otherwise: str = "it did not happen") -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < deadline_s, f"{otherwise}:\n{self.output}"
            if self.process.poll() is not None:
                self._reader.join(STOP_S)  # its last words may yet have to be read
                assert what(), f"{otherwise}, ended:\n{self.output}"
            time.sleep(0.02)

    def children(self) -> list[psutil.Process]:
        """Return the running child processes, and remember them for `end`."""
        found = psutil.Process(self.process.pid).children(recursive=True)
        self._family.update((child.pid, child) for child in found)
        return found

    def stop(self, number: int) -> int:
        """Send a signal; the exit code."""
        self.children()
        self.process.send_signal(number)
        return self.wait(STOP_S)

    def wait(self, timeout_s: float = MISSION_S) -> int:
        """Return the exit code once the process has ended on its own."""
        try:
            code = self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"still running after {timeout_s} s:\n{self.output}") from None
        self._reader.join(STOP_S)
        return code

    def orphans(self) -> list[psutil.Process]:
        """Its children that have outlived it."""
        return [child for child in self._family.values() if child.is_running()]

    def kill(self) -> None:
        """SIGKILL for it and all that it started."""
        if self.process.poll() is None:
            self.children()
            self.process.kill()
        self.process.wait()
        for child in self.orphans():
            child.kill()
        self._reader.join(STOP_S)
        self.process.stdout.close()


def write_config(folder: Path, **sections: dict) -> Path:
    """Write a configuration with the built-in house and the simulated detector."""
    path = folder / "config.yaml"
    base = {"perception": {"detector": {"kind": "sim"}}, "mission": {"target": "television"}}
    config = {**base, **sections}
    # A slow machine is no reason to give a mission up.
    config["mission"] = {"time_limit_s": 1e6, **config["mission"]}
    path.write_text(json.dumps(config), encoding="utf-8")
    return path


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def edge(tmp_path) -> Iterator[Callable[..., Edge]]:
    """Start `edge` commands; kill all of them at the end."""
    started = []

    def start(*arguments: object, **environ: str) -> Edge:
        started.append(Edge(*arguments, cwd=tmp_path, **environ))
        return started[-1]

    yield start
    for process in started:
        process.kill()


@pytest.fixture
def script() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start other Python programs, with these arguments and pipes; kill all of them at the end."""
    started = []

    def start(*arguments: object, **options: object) -> subprocess.Popen[str]:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, **options}
        started.append(subprocess.Popen([sys.executable, *map(str, arguments)], **pipes))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def command(capsys, monkeypatch) -> Callable[..., tuple[int, str]]:
    """Run a command in this process without changing its signal handlers; its code and output."""
    monkeypatch.setattr("signal.signal", lambda *_: None)

    def run(*words: object) -> tuple[int, str]:
        code = main([str(word) for word in words])
        said = capsys.readouterr()
        return code, said.out or said.err

    return run
