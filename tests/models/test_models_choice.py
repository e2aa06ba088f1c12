"""`edge models pull`, `check` and `list` of models that have several files."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from tiny_vlm import publish

from edge.cli.main import main
from edge.geometry import SE2, Grid
from edge.host import resources
from edge.lab.bench import choices
from edge.lab.bench.frames import BenchFrames
from edge.lab.sim.base import FloorPlan, WorldObject
from edge.models import pull
from edge.perception.runtime.card_types import ChoiceCard
from edge.perception.runtime.cards import all_cards, load_card
from edge.perception.scoring.choice.question import Mark, MarkedView
from edge.types import Observation

MARKS = tuple(Mark(i, 0.0, 0.0, bearing, 3.0) for i, bearing in enumerate((0.5, 0.0, -0.5)))
DECODER = "onnx/decoder_model_merged.onnx"


@pytest.fixture
def published(tmp_path, monkeypatch):
    """Return a model's folder as published, and a card of it; the cache is empty."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    place = tmp_path / "place"
    folder = place / publish(place, "smolvlm", pinned=False).folder
    resources.models_dir().mkdir(parents=True)
    shutil.copy(place / "tiny.yaml", resources.models_dir())
    return folder


def change_card(**changes):
    path = resources.models_dir() / "tiny.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **changes}))


def says(capsys, *args, code=0):
    assert main([*([] if args[0] == "bench" else ["models"]), *args]) == code
    out, err = capsys.readouterr()
    return out + err


def test_from_a_folder_to_a_sound_model(published, capsys):
    assert "missing" in next(line for line in says(capsys, "list").splitlines() if "tiny" in line)
    assert "run `edge models pull tiny --from FOLDER`" in says(
        capsys, "list", "--check", "tiny", code=1
    )
    lines = says(capsys, "pull", "tiny", "--from", str(published)).splitlines()
    card = load_card("tiny")
    assert len(lines) == len(card.parts) == 9
    assert all("from now on" in line for line in lines)
    assert card.is_here()
    checked = says(capsys, "list", "--check", "tiny")
    assert "tiny: ok (hashes of 9 files, interface, template, tokens; of noise: A 0." in checked
    assert " MB" in next(line for line in says(capsys, "list").splitlines() if "tiny" in line)
    (row,) = (row for row in json.loads(says(capsys, "list", "--json")) if row["name"] == "tiny")
    assert row["path"] == str(card.path)
    again = says(capsys, "pull", "tiny", "--from", str(published))
    assert again.count("already here") == 9


def test_the_hash_of_the_first_pull_counts_from_then_on(published, capsys):
    says(capsys, "pull", "tiny", "--from", str(published))
    kept = load_card("tiny").path / DECODER
    sound = kept.read_bytes()
    kept.write_bytes(sound[:-1] + b"?")
    assert "damaged or another model" in says(capsys, "list", "--check", "tiny", code=1)
    (published / DECODER).write_bytes(sound[:-1] + b"!")  # the publisher has another one now
    refused = says(capsys, "pull", "tiny", "--from", str(published), code=69)
    assert "sha256 is" in refused
    assert "tiny: its onnx/decoder_model_merged.onnx could not be downloaded" in refused
    (published / DECODER).write_bytes(sound)
    says(capsys, "pull", "tiny", "--from", str(published))
    assert kept.read_bytes() == sound


@pytest.mark.parametrize("at", ["the card's", "--from"])
def test_from_a_server(published, capsys, server, monkeypatch, at):
    says(capsys, "pull", "tiny", "--from", str(published))
    card = load_card("tiny")
    for path in card.path.glob("onnx/decoder*"):
        path.unlink()
    server.put(f"/repo/{DECODER}", (published / DECODER).read_bytes())
    if at == "--from":
        told = says(capsys, "pull", "tiny", "--from", server.url("/repo"))
    else:  # cards name none but addresses of https
        ours = card.model_copy(update={"url": server.url("/repo/")})
        monkeypatch.setattr(pull, "load_card", lambda name: ours)
        told = says(capsys, "pull", "tiny")
    assert told.count("already here") == 8
    assert told.count("from now on") == 1
    assert card.is_here()


def test_a_page_in_the_place_of_a_file_is_refused(published, capsys):
    change_card(decoder={"file": DECODER, "mb": 87.0})
    said = says(capsys, "pull", "tiny", "--from", str(published), code=69)
    assert "0.0 MB, but the model card says 87" in said
    assert not (load_card("tiny").path / DECODER).exists()


@pytest.mark.parametrize(
    ("change", "says_so"),
    [
        ({"decoder": {"file": "../decoder.onnx"}}, "decoder.file"),
        ({"folder": "../x"}, "folder"),
        ({"url": "http://example.org/"}, "url"),
        ({"url": "https://example.org/no-slash"}, "url"),
        ({"embed_tokens": None}, "vision_encoder: set embed_tokens too"),
    ],
)
def test_a_card_that_cannot_be(published, capsys, change, says_so):
    change_card(**change)
    assert says_so in says(capsys, "list", "--check", "tiny", code=69)


def test_a_model_of_several_files_has_no_single_file(published, capsys):
    said = says(capsys, "list", "--check", "tiny", "--file", str(published / DECODER), code=69)
    assert "tiny': has several files" in said


def test_shipped_choice_cards_name_all_their_files():
    cards = [card for card in all_cards() if isinstance(card, ChoiceCard)]
    assert {"smolvlm-256m-q4", "qwen2-vl-2b-q4f16", "smollm2-135m-q4"} <= {c.name for c in cards}
    for card in cards:
        names = [Path(part.file).name for part in card.parts]
        assert len(set(names)) == len(names)
        assert {"config.json", "tokenizer.json", "tokenizer_config.json"} <= set(names)
        assert ("preprocessor_config.json" in names) == (card.vision_encoder is not None)
        assert card.url.startswith("https://huggingface.co/")
        assert card.image_tokens < card.max_tokens


def test_variants_are_compared_on_the_same_views(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    for name, half in (("tiny-fp32", False), ("tiny-fp16", True)):
        publish(resources.models_dir(), "smolvlm", name, half=half)
    said = yaml.safe_load((resources.models_dir() / "tiny-fp16.yaml").read_text())
    lost = {**said, "name": "tiny-lost", "folder": "nowhere"}
    (resources.models_dir() / "tiny-lost.yaml").write_text(yaml.safe_dump(lost))
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for k in range(2):
        picture = np.random.default_rng(k).integers(0, 255, (120, 160, 3), np.uint8)
        cv2.imwrite(str(pictures / f"{k}.png"), picture)
    told = says(
        capsys, "bench", "--models", "smolvlm", "--images", str(pictures), "--threads", "1",
        "--providers", "cpu", "--json", str(tmp_path / "out.json"),
    )  # fmt: skip
    reference, half, missing = json.loads((tmp_path / "out.json").read_text())
    assert (reference["name"], half["name"]) == ("tiny-fp32", "tiny-fp16")
    assert "same" not in reference
    assert half["same"] == 1.0
    assert half["difference"] < 0.05
    assert missing["why"].startswith("not here: run `edge models pull tiny-lost")
    assert "tiny-fp16  cpu" in told
    assert "tiny-lost on cpu: not here" in told


class Corridor:
    """East and west of the start; a bed in the east."""

    def __init__(self, bed: str = "bed"):
        box = ((4.0, 0.5, 0.3), (0.4, 0.4, 0.4), 0.0)
        cells = np.ones((20, 100), np.uint8)
        cells[5:15] = 0
        self.plan = FloorPlan(Grid(cells, (-5.0, -1.0), 0.1))
        self.objects = [WorldObject(1, bed, bed, bed, *box)]


@pytest.mark.parametrize(
    ("yaw_rad", "obj", "expected"),
    [
        (0.0, "bed", [False, True, False]),  # ahead; the others end at the walls
        (np.pi, "bed", [True, False, True]),  # the way ahead leads away
        (0.0, "lamp", [False] * 3),  # none there
    ],
)
def test_the_correct_mark_leaves_the_shortest_path(yaw_rad, obj, expected):
    world, pose = Corridor(obj), SE2(0.0, 0.0, yaw_rad)
    pictures = BenchFrames("one", [], (), None, world, (pose,))
    view = MarkedView(Observation(0, 0, np.eye(4)), "bed", MARKS)
    remaining_m = np.array([choices._remaining_m(pictures, view)])
    assert choices.correct_marks(remaining_m).tolist() == [expected]
    blind = BenchFrames("one", [], (), None)
    assert not choices.correct_marks(np.array([choices._remaining_m(blind, view)])).any()


def test_the_small_scorer_is_listed_with_its_family(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    told = says(
        capsys, "bench", "--models", "mini-house", "demo", "--frames", "4", "--providers", "cpu",
        "--threads", "1", "--json", str(tmp_path / "out.json"),
    )  # fmt: skip
    kept = json.loads((tmp_path / "out.json").read_text())
    assert [row["name"] for row in kept["rows"]] == ["mini-house-256x320-int8-cpu"]
    (row,) = kept["directions"]
    assert row["name"] == "mini-house-choice"
    assert 0.0 < row["ms_p50"] <= row["ms_p95"]
    assert row["memory_mb"] > 0
    assert row["of_views"] > 0
    assert 0.0 <= row["right"] <= 1.0
    assert told.index("256x320-int8-cpu  cpu") < told.index("mini-house-choice  cpu")
    assert "by chance" in told
