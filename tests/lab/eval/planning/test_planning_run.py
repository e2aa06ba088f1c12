"""`edge eval planning` from its options to its files."""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import textwrap

import pytest
from live_patience import PATIENCE_S

from edge.cli.parsers import make_parser
from edge.errors import FileError, UserError
from edge.lab.eval.planning import run as command
from edge.lab.eval.planning.planners import PLANNERS


def parsed(*argv: str) -> argparse.Namespace:
    return make_parser().parse_args(["eval", "planning", *argv])


def test_runs_and_writes(tmp_path, capsys):
    out = tmp_path / "new" / "folder"
    assert (
        command.run(parsed("--n", "20", "--p-obs", "0.5,1", "--workers", "1", "--out", str(out)))
        == 0
    )
    text = capsys.readouterr().out
    assert text.startswith("20 tasks, ")
    for planner in PLANNERS:
        assert re.search(rf"^{planner} +all +40 +100.00 \[", text, re.M)
    data = json.loads((out / "results.json").read_text())
    assert {row["complete"]["value"] for row in data["rows"]} == {1.0}


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("--p-obs", "0"), "above 0 and at most 1, got 0"),
        (("--p-obs", "0.5,1.5"), "above 0 and at most 1, got 1.5"),
        (("--p-obs", "nan"), "above 0"),
        (("--p-obs", "half"), "expected probabilities such as 0.5,1, got 'half'"),
        (("--p-obs", ""), "expected probabilities"),
        (("--n", "0"), "expected an integer from 1, got"),
        (("--episodes", "-1"), "expected an integer from 1, got"),
        (("--seed", "-1"), "expected an integer from 0 to 2**63 - 1, got -1"),
        (("--workers", "two"), "invalid"),
    ],
)
def test_bad_options(argv, words, capsys):
    with pytest.raises(SystemExit):
        parsed(*argv)
    assert words in capsys.readouterr().err.splitlines()[-1]


def test_bad_input_is_an_error_of_one_line(tmp_path):
    (tmp_path / "file").write_text("{}")
    for argv, words in (
        (("--planners", "vitl,best"), "no planner 'best' (choices: vitl"),
        (("--planners", ","), "got no name"),
        (("--n", "1", "--out", str(tmp_path / "file" / "x")), "file"),
    ):
        with pytest.raises(UserError) as caught:
            command.run(parsed(*argv))
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


def test_the_table_is_complete_if_a_file_cannot_be_written(tmp_path, capsys):
    (tmp_path / "results.json").mkdir()
    with pytest.raises(FileError) as caught:
        command.run(parsed("--n", "1", "--p-obs", "1", "--workers", "1", "--out", str(tmp_path)))
    assert str(caught.value).startswith(f"{tmp_path / 'results.json'}: cannot be written: ")
    assert str(caught.value).endswith("; for the file, run again with another folder")
    assert "100.00" in capsys.readouterr().out


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_an_interrupt_ends_the_command_with_its_processes(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        textwrap.dedent("""
        import pathlib, signal, sys, time
        if __name__ != "__main__":
            try:
                pathlib.Path("first").touch(exist_ok=False)
            except FileExistsError:  # the second worker still imports at the interrupt
                while not pathlib.Path("interrupted").exists():
                    time.sleep(0.01)
        from edge.cli.parsers import make_parser
        from edge.lab.eval.planning import run as command
        from edge.host import progress
        def reach(bar, done):
            print("working", flush=True)
            time.sleep(3600)
        if __name__ == "__main__":
            progress.ProgressBar.set_done = reach
            # A process started in the background by a shell script ignores it.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            args = make_parser().parse_args(["eval", "planning", *sys.argv[1:]])
            try:
                command.run(args)
            except KeyboardInterrupt:
                sys.exit(130)
        """)
    )
    argv = ["--n", "60", "--episodes", "50", "--workers", "2", "--out", str(tmp_path)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A group of its own gets the signal, as a terminal's Ctrl-C goes to all of its processes.
    command = [sys.executable, script, *argv]
    process = subprocess.Popen(command, cwd=tmp_path, start_new_session=True, **pipes)
    try:
        while "working" not in process.stdout.readline():
            assert process.poll() is None
        os.killpg(process.pid, signal.SIGINT)
        (tmp_path / "interrupted").touch()
        _, err = process.communicate(timeout=PATIENCE_S)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    assert "Traceback" not in err
