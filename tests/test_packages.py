"""The scripts that make packages, as far as they end at once; `.ci/run` runs them to the end."""

from __future__ import annotations

import os
import re
import subprocess
from importlib import metadata
from pathlib import Path

import pytest

import edge
from edge.config import load

ROOT = Path(__file__).parents[1]
PACKAGES = ROOT / "packages"


def test_the_version_is_one_constant():
    project = (ROOT / "pyproject.toml").read_text()
    assert 'dynamic = ["version"]' in project
    assert 'path = "edge/__init__.py"' in project
    assert metadata.version("edge-vln") == edge.__version__


@pytest.mark.parametrize("name", ["deb", "try-deb", "first-goal"])
@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), os.EX_USAGE, r"usage: .+"),
        (
            ("none.whl",),
            os.EX_UNAVAILABLE,
            r"none\.whl: (no such file; make it|no Debian package; name a file in) .+",
        ),
    ],
)
def test_a_missing_package_is_an_error_of_one_line(name, arguments, code, message):
    done = subprocess.run([PACKAGES / name, *arguments], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (code, "")
    assert re.fullmatch(rf"(packages/{name}: )?{message}\n", done.stderr)


def test_a_missing_engine_is_an_error_of_one_line():
    environ = {**os.environ, "ENGINE": "no-such-engine"}
    done = subprocess.run([PACKAGES / "try-image"], capture_output=True, text=True, env=environ)
    assert (done.returncode, done.stdout) == (os.EX_UNAVAILABLE, "")
    assert done.stderr == "packages/try-image: no-such-engine: does not run here\n"


def test_a_release_overwrites_nothing(tmp_path):
    (tmp_path / "old.whl").touch()
    done = subprocess.run([PACKAGES / "release", tmp_path], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (os.EX_UNAVAILABLE, "")
    assert done.stderr == f"packages/release: {tmp_path}: not empty; name a new folder\n"


def test_the_packages_configuration_runs_without_other_models():
    config = load(str(PACKAGES / "debian" / "edge.yaml"))
    assert config.mission.on_request
    assert config.http.port == 7480
    assert (ROOT / "models" / f"{config.perception.detector.model}.onnx").is_file()
