"""Users without a home, code that is read-only, and signals at a bad moment."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from edge_processes import write_config

pytestmark = pytest.mark.slow

STRANGER = 54321  # no user of any machine
# It may read whatever this test may read, as a hardened unit can, but write nothing of it.
BECOME = (
    "setpriv", f"--reuid={STRANGER}", f"--regid={STRANGER}", "--clear-groups",
    "--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search",
)  # fmt: skip


@pytest.fixture
def config(endpoint, tmp_path) -> Path:
    return write_config(tmp_path, zenoh={"endpoint": endpoint})


@pytest.fixture
def temporary(tmp_path) -> Path:
    """Return the one folder that every user can write to."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    folder.chmod(0o777)
    return folder


@pytest.fixture
def as_stranger(temporary) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run an `edge` command for a user without a name and a home."""
    if os.getuid() != 0 or shutil.which("setpriv") is None:
        pytest.skip("only root can become another user, with setpriv of util-linux")

    def run(*words: str, **environ: str) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [*BECOME, sys.executable, "-m", "edge.cli", *words], cwd="/", text=True,
            env={"PATH": os.environ["PATH"], "TMPDIR": str(temporary), **environ},
            capture_output=True, timeout=240,
        )  # fmt: skip
        assert "Traceback" not in done.stderr, done.stderr
        return done

    return run


def test_an_error_without_a_home_names_the_variable_to_set(as_stranger, temporary):
    done = as_stranger("models", "list")
    assert done.returncode == os.EX_CONFIG
    assert f"user {STRANGER} has no home folder: set EDGE_CACHE_DIR" in done.stderr
    done = as_stranger("doctor")
    assert done.returncode == 1
    assert done.stdout.count("set EDGE_CACHE_DIR") == 1
    assert "please report" not in done.stdout
    assert list(temporary.iterdir()) == []


def test_without_a_kernel_cache_kernels_compile_with_a_warning(as_stranger, temporary):
    for environ in ({}, {"HOME": "/"}):
        done = as_stranger("mission", "explain", "go to the bed", **environ)
        assert done.returncode == 0, done.stderr
        assert "set EDGE_CACHE_DIR (or NUMBA_CACHE_DIR)" in done.stderr
    assert list(temporary.iterdir()) == []


def test_a_user_without_a_home_needs_only_one_folder(as_stranger, temporary):
    done = as_stranger("mission", "explain", "go to the bed", EDGE_CACHE_DIR=str(temporary))
    assert (done.returncode, done.stderr) == (0, "")
    assert {entry.name for entry in temporary.iterdir()} == {"kernels", "sha256.json"}


@pytest.mark.parametrize("command", [["run"], ["sim", "--motion-only"]])
def test_a_stop_is_obeyed_while_kernels_are_compiled(edge, config, temporary, command):
    service = edge("--log-level", "debug", *command, config, NUMBA_CACHE_DIR=str(temporary))
    # A kernel is compiled and written: others follow.
    service.until(lambda: list(temporary.rglob("*.nbc")), "it never compiled")
    assert service.stop(signal.SIGTERM) == 0, service.output
    assert "stopped during the start, before the service was ready" in service.output
    assert "preparing kernels 6/6" not in service.output
    assert "ready:" not in service.output


def test_sigquit_stops_in_order_and_sigusr1_only_shows_threads(edge, config, tmp_path):
    report = tmp_path / "report"
    service = edge("run", config, "--report", report).says("ready:")
    service.process.send_signal(signal.SIGUSR1)
    service.says("most recent call last")
    assert service.stop(signal.SIGQUIT) == 0, service.output
    assert "SIGQUIT: stopping" in service.output
    assert (report / "report.html").exists()
