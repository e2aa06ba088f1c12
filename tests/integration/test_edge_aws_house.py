"""A furnished house, real weights, every process, from the command line to the end."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from edge_processes import Edge

from edge import config
from edge.host import resources
from edge.perception.runtime.cards import ModelError, load_card, verify_model

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

CLONE = Path(__file__).resolve().parents[2]  # the configuration's paths are relative to it


@pytest.fixture
def environ(shared_dir) -> dict[str, str]:
    """Return an environment with the text embeddings; skip without world, extra or model."""
    for module in ("trimesh", "embreex", "onnxruntime"):
        pytest.importorskip(module, reason=f"{module} is not installed (extras `worlds`, `cpu`)")
    settings = config.load("aws-house")
    if not (CLONE / settings.sim.world.mesh).is_file():
        pytest.skip("test data not there: the furnished house")
    try:
        verify_model(load_card(settings.perception.detector.model))
    except ModelError as error:
        pytest.skip(str(error))
    return {
        "EDGE_VOCABULARY": str(shared_dir / "models" / "clip_vitb32_vocab.npz"),
        "EDGE_CACHE_DIR": str(resources.cache_dir()),
        "EDGE__MISSION__TIME_LIMIT_S": "120",
    }


def test_an_episode_ends_with_a_clear_outcome(environ, tmp_path):
    command = [sys.executable, "-m", "edge.cli", "eval", "episodes", "config/aws-house.yaml"]
    out, pages = tmp_path / "out", tmp_path / "pages"
    command += ["--targets", "chair", "--starts", "1", "--out", str(out), "--report", str(pages)]
    done = subprocess.run(
        command, cwd=CLONE, env={**os.environ, **environ}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    outcome = json.loads((out / "outcomes.jsonl").read_text(encoding="utf-8"))
    assert outcome["target"] == "chair"
    assert outcome["reason"]
    assert outcome["failure"] != "crashed", outcome
    assert outcome["elapsed_s"] > 1.0
    assert outcome["path_m"] > 0.1
    assert "1/1" in done.stdout
    (picture,) = pages.rglob("report.png")
    assert picture.stat().st_size > 10_000


WORDS = (
    "Go to the chair or the bed, then to the trash can, then to the sofa; "
    "don't go to the tv before the sofa."
)


def test_a_mission_with_a_choice_and_a_prohibition(environ, endpoint, tmp_path):
    """Run in lockstep, so that the load of the machine does not matter."""
    extra = {
        **environ,
        "EDGE__ZENOH__ENDPOINT": endpoint,
        "EDGE__LOOP__LOCKSTEP": "true",
        "EDGE__SIM__LOCKSTEP": "true",
        "EDGE__MISSION__TIME_LIMIT_S": "300",
    }
    sim = Edge("sim", "config/aws-house.yaml", cwd=CLONE, **extra)
    try:
        arguments = ["--mission", WORDS, "--once", "--report", tmp_path]
        run = Edge("run", "config/aws-house.yaml", *arguments, cwd=CLONE, **extra)
        try:
            assert run.wait(900) == 0, run.output
        finally:
            run.kill()
    finally:
        sim.kill()
    assert re.search(r"reached: (chair|bed), then trash can, then sofa", run.output), run.output
    assert "<svg" in (tmp_path / "report.html").read_text(encoding="utf-8")
