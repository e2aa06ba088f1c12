from __future__ import annotations

import hashlib
import json
import os
from functools import partial

import onnx_bytes
import pytest
import yaml

from edge.host import resources
from edge.models import listing
from edge.perception.runtime import card_types, cards, model_file

CARD = {
    "name": "tiny",
    "family": "yolo-world",
    "task": "detect",
    "file": "tiny.onnx",
    "sha256": None,
    "sources": [{"kind": "url", "url": "https://example.org/w.pt", "sha256": "0" * 64}],
    "license": "AGPL-3.0",
    "input": {"height": 64, "width": 64},
    "precision": "fp32",
    "derived_from": None,
    "preprocess": {"color": "rgb", "scale": 1 / 255, "letterbox_pad": 114},
    "text_dim": 512,
    "parity": None,
}
DATA = onnx_bytes.detector()


@pytest.fixture
def place(cards):
    """Return `write(**changes)`, which puts a card into an empty folder; the cache is empty."""

    def write(stem="tiny", **changes):
        (cards / f"{stem}.yaml").write_text(yaml.safe_dump({**CARD, **changes}))

    return write


def sidecar(card):
    return card.path.with_name(card.file + ".json")


def put_model(content=DATA, sidecar_of=DATA):
    card = cards.load_card("tiny")
    card.path.write_bytes(content)
    made = {"sha256": hashlib.sha256(sidecar_of).hexdigest(), "bytes": len(sidecar_of)}
    sidecar(card).write_text(json.dumps(made))
    return card


def test_no_cards(place):
    assert cards.all_cards() == []
    assert listing.as_table(cards.all_cards()) == "no model cards"
    with pytest.raises(cards.ModelError, match=r"'tiny': no such card \(choices: none\)"):
        cards.load_card("tiny")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"precision": "int4"}, "precision: "),
        ({"inputs": 1}, "inputs: unknown key"),
        ({"input": {"height": 65, "width": 64}}, "input.height: "),
        ({"sha256": "abc"}, "sha256: "),
        ({"file": "../../etc/passwd.onnx"}, "file: "),
        ({"name": "other"}, "must be the file's name 'tiny'"),
        ({"sources": [{"kind": "ftp"}]}, "sources.0.kind: unknown 'ftp' (choices: url, wheel)"),
        ({"sources": [{}]}, "sources.0.kind: missing (choices: url, wheel)"),
    ],
)
def test_a_bad_card_names_file_and_key(place, changes, message):
    place(**changes)
    with pytest.raises(cards.ModelError) as error:
        cards.load_card("tiny")
    assert "tiny.yaml: " in str(error.value)
    assert message in str(error.value)


@pytest.mark.parametrize("text", ["", "- a\n", "name: [", "\x00", "a: 2024-13-45", "[" * 1000])
def test_an_invalid_card_is_named(place, tmp_path, text):
    (tmp_path / "cards" / "tiny.yaml").write_text(text)
    with pytest.raises(cards.ModelError, match=r"tiny\.yaml: "):
        cards.load_card("tiny")


FILE = {k: CARD[k] for k in ("family", "file", "sha256", "sources", "license", "precision")} | {
    "name": "tiny", "derived_from": None, "parity": None,
}  # fmt: skip
PIXELS = {"color": "rgb", "scale": 1 / 255, "mean": [0.5] * 3, "std": [0.5] * 3}
OF_TASK = {
    "detect": CARD,
    "text": FILE | {"task": "text", "dim": 64, "tokenizer": {"kind": "attributes"}},
    "image": FILE | {"task": "image", "dim": 64, "preprocess": PIXELS, "input": CARD["input"]},
    "similarity": {
        "name": "tiny", "family": "f", "task": "similarity", "license": "MIT", "detector": "other",
    },
}  # fmt: skip
LOADERS = {
    "detect": cards.load_detector_card,
    "text": partial(cards.load_card_of, card_types.TextCard),
    "image": partial(cards.load_card_of, card_types.ImageCard),
    "similarity": partial(cards.load_card_of, card_types.SimilarityCard),
}


@pytest.mark.parametrize("task", OF_TASK)
def test_a_card_loads_only_for_its_own_task(place, tmp_path, task):
    (tmp_path / "cards" / "tiny.yaml").write_text(yaml.safe_dump(OF_TASK[task]))
    assert LOADERS[task]("tiny") == cards.load_card("tiny")
    for other in set(LOADERS) - {task}:
        with pytest.raises(cards.ModelError, match=f"of task '{task}', not '{other}'"):
            LOADERS[other]("tiny")


@pytest.mark.parametrize(
    ("task", "changes", "message"),
    [
        ("detect", {"task": "drive"}, "task: unknown 'drive' (choices: detect, text, image, "),
        ("text", {"tokenizer": {}}, "tokenizer.kind: missing"),
        ("text", {"tokenizer": {"kind": "bpe"}}, "tokenizer.kind: unknown 'bpe' (choices: clip, "),
        ("text", {"tokenizer": {"kind": "clip", "file": "../t.json"}}, "tokenizer.file: "),
        ("detect", {"sources": [{**CARD["sources"][0], "url": "http://[bad"}]}, "sources.0.url: "),
        ("image", {"input": {"height": 224}}, "input.width: missing"),
        ("image", {"measured": {"here": [1]}}, "measured.here: "),
        ("detect", {"task": "marks", "parity": {"reference": "x"}}, "parity.inputs: missing"),
        (
            "similarity",
            {"detector": None},
            "tiny.yaml: set image_encoder and text_encoder, or only detector",
        ),
        (
            "similarity",
            {"text_encoder": "t"},
            "tiny.yaml: set image_encoder and text_encoder, or only detector",
        ),
    ],
)
def test_a_bad_card_of_any_task_names_file_and_key(place, tmp_path, task, changes, message):
    (tmp_path / "cards" / "tiny.yaml").write_text(yaml.safe_dump(OF_TASK[task] | changes))
    with pytest.raises(cards.ModelError) as error:
        cards.load_card("tiny")
    assert message in str(error.value)
    assert all(line.startswith(str(tmp_path)) for line in str(error.value).splitlines())


def test_a_shipped_model_is_preferred_to_the_cache(place, tmp_path):
    place()
    card = put_model()
    shipped = tmp_path / "cards" / "tiny.onnx"
    assert card.path == resources.models_dir() / "tiny.onnx"
    shipped.write_bytes(DATA)
    assert card.path == shipped
    with pytest.raises(cards.ModelError, match="reinstall"):
        cards.verify_model(card)


def test_a_missing_model_names_the_export_command(place):
    place()
    with pytest.raises(cards.ModelError, match=r"tiny\.onnx: .* `edge models export tiny"):
        cards.verify_model(cards.load_card("tiny"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (DATA[:-50], f"truncated: {len(DATA) - 50} of {len(DATA)} bytes"),
        (DATA[:-1] + b"X", "damaged"),
        (b"", "truncated"),
    ],
)
def test_a_damaged_model_is_refused(place, content, message):
    place()
    with pytest.raises(cards.ModelError, match=message):
        cards.verify_model(put_model(content))


def test_the_hash_in_the_card_is_checked_first(place):
    place(sha256="1" * 64)
    with pytest.raises(cards.ModelError, match="sha256 is not 111111111111"):
        cards.verify_model(put_model())


def test_a_model_without_any_hash_is_refused(place):
    place()
    card = put_model()
    sidecar(card).unlink()
    with pytest.raises(cards.ModelError, match=r"tiny\.onnx\.json: no sha256"):
        cards.verify_model(card)


def flip_a_byte(path, at=-1):
    """As flash rots: size and time of change stay; a second time, it is sound again."""
    before = path.stat().st_mtime_ns
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(before, before))


@pytest.fixture
def hashed(monkeypatch):
    files, hash_file = [], model_file.sha256_of

    def note(path):
        files.append(path)
        return hash_file(path)

    monkeypatch.setattr(model_file, "sha256_of", note)
    return files


def test_damage_under_an_unchanged_time_of_change_is_seen(place):
    place()
    card = put_model()
    assert cards.verify_model(card) == card.path
    flip_a_byte(card.path)
    line = (
        rf"^{card.path}: damaged or another model: sha256 is not .*; run `edge models export tiny`$"
    )
    with pytest.raises(cards.ModelError, match=line):
        cards.verify_model(card)


def test_a_trusted_cache_is_believed_until_the_file_is_written(place, hashed, monkeypatch):
    monkeypatch.setenv(model_file.TRUST_CACHE, "1")
    place()
    card = put_model()
    load = partial(cards.verify_model, card, believe_cache=True)
    load()
    assert len(hashed) == 1
    flip_a_byte(card.path)
    load()
    assert len(hashed) == 1
    with pytest.raises(
        cards.ModelError, match="damaged"
    ):  # `models list --check` and the doctor look
        cards.verify_model(card)
    os.utime(card.path, ns=(1, 1))
    with pytest.raises(cards.ModelError, match="damaged"):
        load()


def test_a_repaired_model_loads_again(place):
    place()
    card = put_model(DATA[:-1] + b"X")
    written = card.path.stat().st_mtime_ns
    with pytest.raises(cards.ModelError, match="damaged"):
        cards.verify_model(card)
    card.path.write_bytes(DATA)
    os.utime(card.path, ns=(written, written))
    assert cards.verify_model(card) == card.path


def test_an_unreadable_model_is_an_error_of_one_line(place, monkeypatch):
    place()

    def refuse(path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(model_file, "sha256_of", refuse)
    line = r"^\S*tiny\.onnx: cannot be read \(Permission denied\); make it readable, or remove it$"
    with pytest.raises(cards.ModelError, match=line):
        cards.verify_model(put_model())


def test_a_broken_hash_cache_does_no_harm(place):
    place()
    card = put_model()
    (resources.cache_dir() / "sha256.json").write_text("[1, 2")
    assert cards.verify_model(card) == card.path


def own(name, **changes):
    """Put a card into the models' cache, the folder of user models."""
    card = {**CARD, "name": name, "file": f"{name}.onnx", **changes}
    (resources.models_dir() / f"{name}.yaml").write_text(yaml.safe_dump(card))


def test_package_cards_come_before_own_cards(place, tmp_path):
    place()
    own("tiny", family="other")
    own("mine")
    assert cards.card_names() == ["mine", "tiny"]
    assert [card.family for card in cards.all_cards()] == ["yolo-world", "yolo-world"]
    assert cards.card_path("mine").parent == resources.models_dir()
    assert cards.card_path("tiny").parent == tmp_path / "cards"
    assert "mine " in listing.as_table(cards.all_cards())


@pytest.mark.parametrize("function", ["listdir", "stat"])
def test_an_unreadable_cache_hides_only_its_own_cards(place, monkeypatch, function):
    place()
    own("mine")
    cache, allowed = str(resources.models_dir()), getattr(os, function)

    def refuse(path, *args, **options):
        if str(path).startswith(cache):
            raise PermissionError(13, "Permission denied")
        return allowed(path, *args, **options)

    monkeypatch.setattr(os, function, refuse)
    assert "tiny" in cards.card_names()
    with pytest.raises(cards.ModelError, match=r"tiny\.onnx: model tiny is not there; "):
        cards.verify_model(cards.load_card("tiny"))


def test_a_broken_card_is_one_line_and_others_load(place, caplog):
    place()
    own("broken", input={"height": 65, "width": 63})
    assert [card.name for card in cards.all_cards()] == ["tiny"]
    (line,) = caplog.messages
    assert line.startswith(f"{resources.models_dir()}/broken.yaml: input.height: ")
    assert "input.width: " in line
    assert "\n" not in line
    with pytest.raises(cards.ModelError, match="choices: broken, tiny"):
        cards.load_card("none")


def test_the_list_shows_present_models_and_their_parity(place):
    parity = {
        "reference": "tiny-fp32", "images": 40, "recall": 0.97, "precision": 0.9,
        "score_error": 0.1,
    }  # fmt: skip
    place(parity=parity)
    assert "missing" in listing.as_table(cards.all_cards())
    put_model()
    table = listing.as_table(cards.all_cards())
    assert "recall 0.970" in table
    assert "missing" not in table
    place()
    assert "recall" not in listing.as_table(cards.all_cards())
    sidecar(cards.load_card("tiny")).write_text(json.dumps({"sha256": "0", "parity": parity}))
    assert "recall 0.970" in listing.as_table(cards.all_cards())  # measured by the export


def test_the_cards_of_this_repository_are_valid(monkeypatch, tmp_path):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    found = cards.card_names()
    if not found:
        pytest.skip("no cards in models/")
    assert [card.name for card in cards.all_cards()] == found
