"""The commands for models and a card whose model runs on a server."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from kserve_server import KServe, serving
from simulated import simulated

from edge.cli import model_checks
from edge.cli.main import main
from edge.perception.runtime.cards import load_card

SMALL = "mini-house-256x320-int8-cpu"


def model(feed):
    n = feed["txt_feats"].shape[1]
    return {"boxes": np.zeros((1, 9, 4), np.float32), "scores": np.zeros((1, 9, n), np.float32)}


@pytest.fixture
def far(tmp_path, monkeypatch):
    """far(url): puts the card there."""
    (tmp_path / "models").mkdir()
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))

    def write(url: str) -> None:
        told = load_card(SMALL).model_dump(mode="json", exclude={"file", "sha256", "measured"})
        told |= {"name": "far", "server": {"url": url, "model": "m", "time_limit_s": 60}}
        (tmp_path / "models/far.yaml").write_text(yaml.safe_dump(told))

    return write


@pytest.mark.parametrize(("binary", "how"), [(True, "bytes"), (False, "JSON, which is slow")])
def test_check_asks_the_server(far, capsys, binary, how):
    with serving(KServe(model, binary)) as server:
        far(server.url)
        assert main(["models", "list", "--check", "far"]) == 0
    said = f"far: ok (on {server.url}, interface, 9 boxes, finite; tensors go as {how})\n"
    assert capsys.readouterr().out.startswith(said)


@pytest.mark.parametrize(
    ("run", "why"),
    [
        (lambda feed: {**model(feed), "boxes": np.full((1, 9, 4), np.nan, np.float32)},
         "returns boxes that are not finite"),
        (lambda feed: {**model(feed), "scores": np.full((1, 9, 2), 1.5, np.float32)},
         "scores must be from 0 to 1"),
        (lambda feed: {"boxes": np.zeros((1, 9, 4), np.float32)},
         "invalid answer: the answer lacks the output 'scores'; check what runs there"),
    ],
)  # fmt: skip
def test_check_reports_an_unusable_model(far, capsys, run, why):
    with serving(KServe(run)) as server:
        far(server.url)
        assert main(["models", "list", "--check", "far"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert server.url in line
    assert why in line


def test_a_model_on_a_server_needs_no_file(far, capsys):
    far("http://127.0.0.1:1")
    runs = "the server http://127.0.0.1:1 runs it"
    assert main(["models", "pull", "far"]) == 0
    assert capsys.readouterr().out.startswith(f"far: nothing to download, {runs}\n")
    assert main(["models", "export", "far"]) != 0
    assert runs in capsys.readouterr().err
    assert main(["models", "list"]) == 0
    (line,) = [x for x in capsys.readouterr().out.splitlines() if x.startswith("far ")]
    assert "on http://127.0.0.1:1" in line


@pytest.mark.parametrize("there", [True, False])
def test_the_doctor_checks_if_a_server_listens(far, there):
    with serving(KServe(model)) as server:
        far(server.url if there else "http://127.0.0.1:1")
        (found,) = [f for f in model_checks.check_models(simulated()) if "model far" in f.what]
    wanted = ("ok", "a server listens at") if there else ("warn", "no server listens at")
    assert (found.level, wanted[1] in found.what) == (wanted[0], True)
