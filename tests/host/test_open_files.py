"""The limit of open files, in processes of their own."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from contextlib import suppress

import pytest

from edge.host import open_files
from edge.host.children import python_module


def limited(soft: int, hard: int, command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["prlimit", f"--nofile={soft}:{hard}", *command],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "command", [["run", "demo"], ["demo"], ["sim", "demo"], ["sim", "demo", "--motion-only"]]
)
def test_a_low_limit_of_open_files_fails_in_one_line(command):
    done = limited(20, 20, [*python_module("edge.cli"), *command])
    assert done.returncode == os.EX_UNAVAILABLE
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("this process may open 20 files and connections, but needs 256:")


def test_a_low_soft_limit_is_raised():
    show = "import resource as r; from edge.host.open_files import raise_open_files_limit"
    show += "; raise_open_files_limit()"
    show += "; print(r.getrlimit(r.RLIMIT_NOFILE)[0])"
    for soft, hard, now in ((20, 300, "300"), (20, 1 << 20, "4096"), (9000, 1 << 20, "9000")):
        if resource.getrlimit(resource.RLIMIT_NOFILE)[1] >= hard:
            assert limited(soft, hard, [sys.executable, "-c", show]).stdout.strip() == now


def test_a_shortage_of_descriptors_is_reported_while_it_lasts():
    assert open_files.open_files_problem() == ""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, before[1]))
    try:
        with suppress(OSError):
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        assert open_files.open_files_problem().startswith(
            "no file or connection can be opened (Too many"
        )
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        for handle in taken:
            os.close(handle)
    assert open_files.open_files_problem() == ""
