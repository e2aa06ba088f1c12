"""A temporary folder is private while it is used, and goes even when its process is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import pytest

from edge.host.private_folder import private_folder

HOLD = """
import sys
from edge.host.private_folder import private_folder
with private_folder("edge-test-", sys.argv[1]) as folder:
    (folder / "inside").touch()
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process in the midst of its block, and its folder."""
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        yield process, tmp_path / os.path.basename(process.stdout.readline().decode().strip())
        process.kill()


def test_the_folder_of_a_killed_process_is_removed(tmp_path, holder):
    process, folder = holder
    (tmp_path / "edge-testimony").mkdir()
    (tmp_path / "edge-test-file").touch()
    (tmp_path / "edge-test-link").symlink_to(tmp_path / "edge-testimony")
    others = {"edge-testimony", "edge-test-file", "edge-test-link"}
    with private_folder("edge-test-", str(tmp_path)):
        assert (folder / "inside").exists(), "in use"
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert (folder / "inside").exists()
    with private_folder("edge-test-", str(tmp_path)) as mine:
        assert {path.name for path in tmp_path.iterdir()} == {mine.name} | others


def test_parallel_folders_do_not_remove_each_other(tmp_path):
    def work() -> None:
        for _ in range(50):
            with private_folder("edge-test-", str(tmp_path)) as folder:
                (folder / "inside").touch()

    failures = []
    threading.excepthook, before = failures.append, threading.excepthook
    try:
        threads = [threading.Thread(target=work) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        threading.excepthook = before
    assert not failures
    assert list(tmp_path.iterdir()) == []
