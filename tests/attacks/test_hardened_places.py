"""A user without a home, and a stop at a bad moment."""

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
