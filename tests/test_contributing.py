"""CONTRIBUTING.md: its paths exist, its model recipe works, and CI's packages are pinned."""

from __future__ import annotations

import hashlib
import re
import shutil
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from simulated import simulated

from edge.cli.main import main
from edge.config.yaml_text import parse_yaml
from edge.lab.eval.closed_loop import ClosedLoop

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
SHIPPED = "mini-house-256x320-int8-cpu"


def test_every_path_in_the_page_exists():
    named = set(re.findall(r"`((?:edge|tests|docs|models|perf|exporters)/[\w./]*)`", PAGE))
    named |= set(re.findall(r"\]\(([\w./]+)\)", PAGE))
    assert len(named) > 20
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


@pytest.fixture
def card(tmp_path, monkeypatch) -> dict:
    """Return the page's card and a file for it, in their own cache."""
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    folder = tmp_path / "models"
    folder.mkdir()
    file = folder / parse_yaml(block)["file"]
    shutil.copy(ROOT / "models" / f"{SHIPPED}.onnx", file)
    block = block.replace("<of the file>", hashlib.sha256(file.read_bytes()).hexdigest())
    card = parse_yaml(block)
    (folder / f"{card['name']}.yaml").write_text(block, encoding="utf-8")
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    return card


def test_a_model_is_a_card_and_a_file(card, capsys):
    assert main(["models", "list", "--check", card["name"]]) == 0
    assert card["name"] in capsys.readouterr().out
    assert card["name"] in re.search(r"EDGE__PERCEPTION__DETECTOR__MODEL=\S+", PAGE)[0]
    detector = {"kind": "onnx", "model": card["name"], "background": ["sofa", "bed"]}
    lockstep = {"loop": {"lockstep": True}, "sim": {"lockstep": True}}
    loop = ClosedLoop(simulated({**lockstep, "perception": {"detector": detector}}))
    loop.step()
    assert loop.service.result().parts()["detector"]["done"] == 1
    loop.close()


def test_packages_installed_by_ci_are_pinned():
    """Otherwise a new release of a package fails our changes."""
    files = ("docker/constraints.txt", ".ci/constraints.txt")
    pins = "\n".join((ROOT / file).read_text(encoding="utf-8") for file in files)
    ours = [Requirement(line) for line in metadata.requires("edge-vln") or ()]
    run = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    extras = {name for some in re.findall(r"-e '\.\[(.+?)\]'", run) for name in some.split(",")}
    extras |= {e for of in ours if of.name == "edge-vln" for e in of.extras}
    wanted = {
        of.name
        for of in ours
        if of.name != "edge-vln"
        and (of.marker is None or any(of.marker.evaluate({"extra": e}) for e in extras))
    }
    assert {"numba", "onnxscript", "pytest", "transformers"} <= wanted
    assert wanted <= set(re.findall(r"^([\w-]+)==", pins, re.MULTILINE))
