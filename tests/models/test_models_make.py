"""`edge models export` and `quantize`: their questions, and their options for the exporter."""

from __future__ import annotations

import os
import re
import shutil

import pytest
import yaml

from edge.cli.main import main
from edge.host import resources
from edge.host.children import python_module
from edge.models import make
from edge.models.local import weights_path
from edge.models.make import require_modules
from edge.perception.runtime.cards import load_card

ORIGINAL = {
    "name": "big", "family": "f", "task": "detect", "file": "big.onnx", "sha256": None,
    "sources": [{"kind": "url", "url": "https://example.org/w.pt", "sha256": "0" * 64}],
    "license": "MIT", "input": {"height": 64, "width": 64}, "precision": "fp32",
    "derived_from": None, "text_dim": 8, "parity": None,
    "preprocess": {"color": "rgb", "scale": 1.0, "letterbox_pad": 0},
}  # fmt: skip
TRAINED = {**ORIGINAL, "name": "own", "family": "mini-house", "sources": []}
DERIVED = {**ORIGINAL, "name": "small", "file": "small.onnx", "derived_from": "big"}
TOWER = {
    **{key: ORIGINAL[key] for key in ("family", "sha256", "license", "parity")},
    "name": "rows", "task": "text", "file": "rows.onnx", "sources": [], "precision": "int8",
    "derived_from": "big", "dim": 8, "tokenizer": {"kind": "attributes"},
}  # fmt: skip
CHOICE = {
    "name": "vlm-fp32", "family": "f", "task": "choice", "license": "MIT", "precision": "fp32",
    "folder": "vlm", "decoder": {"file": "onnx/decoder.onnx"}, "others": [],
}  # fmt: skip
SCORER = {"name": "s", "family": "f", "task": "similarity", "license": "MIT", "detector": "big"}
QUANTIZE = ["export", "--quantize"]


@pytest.fixture
def started(put_card, monkeypatch):
    """Return the exporters' command lines instead of running them."""
    for card in (ORIGINAL, DERIVED, SCORER, TRAINED, TOWER, CHOICE):
        put_card(card)
    lines = []

    class Done:
        returncode = 0

    monkeypatch.setattr(make, "require_modules", lambda *_: None)
    monkeypatch.setattr(make.subprocess, "run", lambda line, **_: lines.append(line) or Done)
    return lines


@pytest.mark.parametrize("sources", [[], ORIGINAL["sources"]])
def test_no_weights_here(started, put_card, capsys, sources):
    put_card({**DERIVED, "sources": sources})
    assert main(["models", "export", "small"]) == os.EX_UNAVAILABLE
    error = capsys.readouterr().err
    assert "name their file with --weights" in error
    assert ("run `edge models pull small`" in error) == bool(sources)
    assert started == []


def test_a_missing_weights_folder_is_an_error(started, capsys):
    assert main(["models", "export", "new", "--weights", "nowhere"]) == os.EX_UNAVAILABLE
    assert capsys.readouterr().err == "models export: --weights nowhere: no such folder\n"


def test_weights_that_were_pulled_are_exported(started):
    path = weights_path(load_card("small").sources[0])
    path.parent.mkdir(parents=True)
    path.write_bytes(b"weights")
    assert main(["models", "export", "small", "--calibration", "pictures"]) == 0
    (line,) = started
    assert tuple(line[:5]) == python_module("exporters")
    assert line[5:] == [
        "small", "--weights", str(path), "--calibration", "pictures",
        "--cache", str(resources.models_dir()), "--cards", str(resources.data_dir("models")),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("given", "told"), [([], ["q4"]), (["--precision", "int8", "q4"], ["int8", "q4"])]
)
def test_variants_of_a_language_model_derive_from_its_fp32(started, monkeypatch, given, told):
    monkeypatch.setattr(make, "verify_parts", lambda card: None)
    words = ["export", "--quantize", "vlm-fp32", "--calibration", "pictures"]
    assert main(["models", *words, *given]) == 0
    cards = ["--cards", str(resources.data_dir("models"))]
    assert started[0][5:9] == ["vlm-fp32", "--calibration", "pictures", "--cache"]
    assert started[0][10:] == [*cards, "--precision", *told]


def test_the_precision_set_in_a_card_cannot_be_changed(started, capsys):
    words = ["--calibration", "p", "--precision", "int8"]
    assert main(["models", "export", "--quantize", "small", *words]) == os.EX_UNAVAILABLE
    assert "small: its card sets the precision" in capsys.readouterr().err
    assert started == []


def test_a_models_folder_needs_no_card(started, tmp_path):
    words = ["--precision", "fp32", "int8-cpu", "--family", "clip-vit-b-32"]
    assert main(["models", "export", "new", "--weights", str(tmp_path), *words]) == 0
    folders = ["--weights", str(tmp_path), "--cache", str(resources.models_dir())]
    assert started[0][5:] == ["new", *folders, *words[3:], *words[:3]]


def test_an_own_card_is_exported_from_its_folder(started):
    card = yaml.safe_dump({**ORIGINAL, "name": "mine"})
    (resources.models_dir() / "mine.yaml").write_text(card)
    assert main(["models", "export", "mine", "--weights", "w.pt"]) == 0
    assert started[0][-2:] == ["--cards", str(resources.models_dir())]


@pytest.mark.parametrize("words", [["export"], ["export", "--weights", "w.pt"], ["pull"]])
def test_a_trained_model_names_its_training_commands(started, capsys, words):
    action, *options = words
    assert main(["models", action, "own", *options]) == os.EX_UNAVAILABLE
    error = capsys.readouterr().err
    assert "`python -m exporters.training.mini --out RUN`" in error
    assert ".pt" not in error
    assert started == []


@pytest.mark.parametrize("lacking", ["source", "place"])
def test_a_vocabulary_that_cannot_be_copied_is_an_error(started, tmp_path, capsys, lacking):
    (tmp_path / "words.npz").write_bytes(b"words")
    if lacking == "source":
        (tmp_path / "words.npz").unlink()
    else:
        shutil.rmtree(resources.cache_dir())
        resources.cache_dir().write_text("a file in the way")
    words = ["--weights", "w.pt", "--vocabulary", str(tmp_path / "words.npz")]
    assert main(["models", "export", "big", *words]) == os.EX_UNAVAILABLE
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{tmp_path}/words.npz: cannot be copied to ")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("big", "is not derived from another model; `edge models export big` makes it"),
        ("own", "is not derived from another model; `python -m exporters.training.mini --out RUN`"),
        ("small", "big.onnx: model big is not there"),
        ("s", "has no file of its own; name one that it uses: big"),
        ("rows", "is not a detector; export it from its model folder: `edge models export NAME "),
        ("none", "no such card"),
        ("vlm-fp32", "decoder.onnx: model vlm-fp32 is not there; run `edge models pull vlm-fp32"),
    ],
)
def test_an_unsuitable_model_cannot_be_quantized(started, capsys, name, message):
    assert (
        main(["models", "export", "--quantize", name, "--calibration", "pictures"])
        == os.EX_UNAVAILABLE
    )
    assert message in capsys.readouterr().err
    assert started == []


@pytest.mark.parametrize(
    ("lacking", "words", "said"),
    [
        ("torch", ["export", "--weights", "w.pt"], "torch not .*'edge-vln.export.'"),
        (
            "ultralytics", ["export", "--weights", "w.pt"],
            "'edge-vln.export.', then pip install --no-deps ultralytics$",
        ),
        ("onnxruntime", ["export", "--weights", "w.pt"], "onnxruntime .*'edge-vln.cpu,export.'"),
        ("onnxruntime", QUANTIZE, "onnxruntime not installed here: .*'edge-vln.cpu,quantize.'"),
        ("onnx", QUANTIZE, "onnx not installed here: pip install 'edge-vln.quantize.'"),
        ("torch", QUANTIZE, None),
    ],
)  # fmt: skip
def test_a_missing_package_is_named(started, monkeypatch, capsys, lacking, words, said):
    monkeypatch.setattr(make, "require_modules", require_modules)
    monkeypatch.setattr(make, "verify_model", lambda card: None)
    find = lambda name: None if name == lacking else name  # noqa: E731
    monkeypatch.setattr(make.importlib.util, "find_spec", find)
    action, *options = words
    code = main(["models", action, "small", *options, "--calibration", "p", "--vocabulary", "v"])
    error = capsys.readouterr().err
    assert (code == 0, len(started)) == ((said is None), int(said is None))
    if said is None:
        assert error == ""
    else:
        assert re.search(said, error)


def test_a_hash_of_the_user_is_handed_on(started):
    words = ["--weights", "w.pt", "--sha256", "ab" * 32]
    assert main(["models", "export", "big", *words]) == 0
    at = started[0].index("--sha256")
    assert started[0][at + 1] == "ab" * 32


def test_a_family_without_a_weights_file_names_the_folder(put_card, capsys):
    put_card({**ORIGINAL, "family": "owlv2-base", "sources": []})
    for action in ("export", "pull"):
        assert main(["models", action, "big"]) == os.EX_UNAVAILABLE
        error = capsys.readouterr().err
        assert (
            "`edge models export owlv2-base --weights FOLDER` makes it, from a folder of " in error
        )


def test_a_network_for_ground_names_its_folder_and_its_licence(capsys):
    assert main(["models", "export", "segformer-b0-fp32"]) == os.EX_UNAVAILABLE
    error = capsys.readouterr().err
    assert "`edge models export segformer-b0 --weights FOLDER` makes it, from a folder of " in error
    assert main(["models", "list", "segformer-b0-int8-cpu"]) == 0
    assert "non-commercial" in capsys.readouterr().out


def test_a_detector_with_its_own_text_encoder_needs_no_vocabulary(started, put_card, monkeypatch):
    put_card({**DERIVED, "text_encoder": "rows"})
    monkeypatch.setattr(make, "verify_model", lambda card: None)
    monkeypatch.delenv("EDGE_VOCABULARY", raising=False)
    assert main(["models", "export", "--quantize", "small", "--calibration", "pictures"]) == 0
    assert "--vocabulary" not in started[0]
