"""Three files of a vision-language model: they answer as the model does that they are made of."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

pytest.importorskip("torch", reason="torch is not installed (extra `transformers`)")
pytest.importorskip("transformers", reason="transformers is not installed (extra `transformers`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")
pytest.importorskip("onnxscript", reason="onnxscript is not installed (extra `transformers`)")

import onnx
import tiny_folders
import torch
from onnx import numpy_helper

from edge.host.files import MAX_TEXT_BYTES
from edge.perception.runtime.cards import load_card
from edge.perception.scoring.vlm.model import LanguageModel, MultipleChoice
from exporters import hugging_face, vlm, vlm_files, vlm_quantize
from exporters.__main__ import main
from exporters.files import ExportError, sha256_of
from exporters.images import read_rgb
from exporters.vlm_parity import OnnxPipeline, Question, questions

pytestmark = [pytest.mark.export, pytest.mark.timeout(600)]

KINDS = ("idefics3", "smolvlm", "qwen2_vl", "qwen3_vl")
EVERY = ("fp32", *vlm_quantize.PRECISIONS)
LARGE = [
    *(("idefics3", p) for p in EVERY),
    *((kind, p) for kind in ("qwen2_vl", "qwen3_vl") for p in ("fp32", "q4")),
]
MADE = [("smolvlm", "fp32"), *LARGE]
MAIN = ("vision_encoder", "embed_tokens", "decoder_model_merged")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    torch.set_num_threads(1)  # more would only wait for each other
    root = tmp_path_factory.mktemp("published")
    return {kind: tiny_folders.write_vlm(root / kind, kind) for kind in KINDS}


@pytest.fixture(scope="module")
def cache(folders, photos, tmp_path_factory):
    """Return the `$EDGE_CACHE_DIR` after exporting each."""
    root = tmp_path_factory.mktemp("cache")
    for kind, folder in folders.items():
        models = root / "models"
        how = ["--cache", models, "--validation", photos, "--no-gate"]
        assert main([*map(str, (name_of(kind), "--weights", folder, *how))]) == 0
        wanted = [p for k, p in MADE if k == kind and p != "fp32"]
        words = [f"{name_of(kind)}-fp32", "--cards", models, "--calibration", photos, *how]
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("EDGE_CACHE_DIR", str(root))
            if wanted:
                assert main([*map(str, words), "--precision", *wanted]) == 0
    return root


def name_of(kind):
    return f"my-{kind.replace('_', '-')}"


def card_of(cache, kind, precision):
    return yaml.safe_load((cache / "models" / f"{name_of(kind)}-{precision}.yaml").read_text())


def files_of(cache, kind, precision):
    """Vision encoder, embedding, decoder."""
    card = card_of(cache, kind, precision)
    folder = cache / "models" / card["folder"]
    return [folder / card[part]["file"] for part in ("vision_encoder", "embed_tokens", "decoder")]


@pytest.fixture(scope="module")
def originals(folders):
    """Return (whole model, questions) for each architecture."""
    found = {}
    for kind, folder in folders.items():
        model, networks = vlm.load_model(folder)
        asked = questions(folder, model.config.image_token_id)
        found[kind] = vlm.TorchReference(model, networks.prepare), asked
    return found


@pytest.fixture(scope="module")
def rgb(photos):
    return read_rgb(sorted(photos.iterdir())[0])


# -- parity ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_the_three_files_answer_as_the_model(cache, originals, rgb, kind):
    """All logits of the last token, not the letters' alone."""
    original, asked = originals[kind]
    chain, shown = OnnxPipeline(files_of(cache, kind, "fp32")), original.show(rgb)
    features = chain.features(shown.feeds)
    np.testing.assert_allclose(features, shown.features, atol=2e-5)
    for question in asked:
        logits = chain.logits(question, features, shown.grid)
        np.testing.assert_allclose(logits, original.logits(question, shown), atol=2e-5)


@pytest.mark.parametrize(("kind", "precision"), MADE)
def test_every_step_keeps_its_parity(cache, kind, precision):
    """Against torch or the FP32 files; 4 bits are too few for the tiny models' letters."""
    limits = {"fp32": (1e-5, 1.0), "int8": (0.03, 0.9)}
    against = "torch" if precision == "fp32" else f"{name_of(kind)}-fp32"
    figures = card_of(cache, kind, precision)["measured"][f"against {against}"]
    error, order = limits.get(precision, (0.3, 0.6))
    assert figures["questions"] == 15
    assert figures["share_error"] < error
    assert figures["rank_agreement"] >= order
    assert figures["cosine"] > 0.999


def test_tiles_may_be_half_empty(cache, originals):
    """Several squares an image, one of them half empty; only one was traced."""
    original, _ = originals["idefics3"]
    random = np.random.default_rng(1)
    side = tiny_folders.SIDE
    feeds = {
        "pixel_values": random.normal(size=(1, 3, 3, side, side)).astype(np.float32),
        "pixel_attention_mask": np.ones((1, 3, side, side), bool),
    }
    feeds["pixel_attention_mask"][0, 1, 18:] = False
    feeds["pixel_attention_mask"][0, 1, :, 9:] = False
    with torch.inference_mode():
        wanted = original._model.model.get_image_features(
            **{key: torch.from_numpy(value) for key, value in feeds.items()}
        ).pooler_output
    wanted = torch.cat(tuple(wanted)).numpy().reshape(-1, wanted[0].shape[-1])
    found = OnnxPipeline(files_of(cache, "idefics3", "fp32")).features(feeds)
    np.testing.assert_allclose(found, wanted, atol=2e-5)


@pytest.mark.parametrize("kind", ["qwen2_vl", "qwen3_vl"])
@pytest.mark.parametrize("hw", [(8, 16), (40, 24)])
def test_a_picture_of_another_grid_than_the_traced_one(cache, originals, hw, kind):
    original, _ = originals[kind]
    shown = original.show(np.random.default_rng(0).integers(0, 256, (*hw, 3), np.uint8))
    found = OnnxPipeline(files_of(cache, kind, "fp32")).features(shown.feeds)
    np.testing.assert_allclose(found, shown.features, atol=2e-5)


# -- files -------------------------------------------------------------------------------------


def ends_of(path):
    """{name: (type, shape)} of inputs and of outputs; a free size by its name."""

    def ends(values):
        return {
            v.name: (
                v.type.tensor_type.elem_type,
                tuple(d.dim_param or d.dim_value for d in v.type.tensor_type.shape.dim),
            )
            for v in values
        }

    graph = onnx.load(path).graph
    return ends(graph.input), ends(graph.output)


@pytest.mark.parametrize("kind", KINDS)
def test_inputs_and_outputs_match_the_published_models(cache, kind):
    single, whole = onnx.TensorProto.FLOAT, onnx.TensorProto.INT64
    vision, embedding, decoder = (ends_of(path) for path in files_of(cache, kind, "fp32"))
    second = "grid_thw" if kind.startswith("qwen") else "pixel_attention_mask"
    deepstack = ["deepstack_features_0", "deepstack_features_1"] if kind == "qwen3_vl" else []
    features = ["image_features", *deepstack]
    assert (list(vision[0]), list(vision[1])) == (["pixel_values", second], features)
    assert embedding[0] == {"input_ids": (whole, ("batch", "tokens"))}
    assert embedding[1]["inputs_embeds"] == (single, ("batch", "tokens", 64))
    pasts = [f"{layer}.{part}" for layer in range(2) for part in ("key", "value")]
    firsts = ["inputs_embeds", "attention_mask", "position_ids", *deepstack]
    assert list(decoder[0]) == firsts + [f"past_key_values.{name}" for name in pasts]
    assert list(decoder[1]) == ["logits", *(f"present.{name}" for name in pasts)]
    assert decoder[0]["past_key_values.1.value"] == (single, ("batch", 2, "past_tokens", 16))
    threefold = (3,) if kind.startswith("qwen") else ()
    assert decoder[0]["position_ids"] == (whole, (*threefold, "batch", "tokens"))


@pytest.mark.parametrize(("kind", "precision"), LARGE)
def test_files_have_the_published_names_and_their_precision(cache, kind, precision):
    kinds = vlm_quantize.PRECISIONS.get(precision, ("fp32",) * 3)
    files = files_of(cache, kind, precision)
    suffixes = ["" if kind == "fp32" else f"_{kind}" for kind in kinds]
    assert [f.name for f in files] == [f"{m}{s}.onnx" for m, s in zip(MAIN, suffixes, strict=True)]
    operators = {n.op_type for n in onnx.load(files[2]).graph.node}
    assert ("MatMulNBits" in operators) == (precision != "fp32")
    if kinds[0] == "int8":
        vision = onnx.load(files[0]).graph
        products = [n for n in vision.node if n.op_type == "MatMul"]
        made_by = {name: node.op_type for node in vision.node for name in node.output}
        static = [n for n in products if made_by.get(n.input[1]) == "DequantizeLinear"]
        assert len(static) >= 9, "two layers of at least four matrices, and what follows"
    if kinds[1] == "int8":
        tables = [numpy_helper.to_array(t) for t in onnx.load(files[1]).graph.initializer]
        assert np.int8 in {table.dtype.type for table in tables}


@pytest.mark.parametrize("kind", ["idefics3", "qwen3_vl"])
def test_a_card_names_every_file_and_each_has_its_hash(cache, kind):
    for precision in (p for k, p in LARGE if k == kind):
        card = card_of(cache, kind, precision)
        assert (card["task"], card["precision"], card["license"]) == ("choice", precision, "mit")
        parts = [card[key] for key in ("vision_encoder", "embed_tokens", "decoder")]
        for part in (*parts, *card["others"]):
            path = cache / "models" / card["folder"] / part["file"]
            content = json.loads(path.with_name(path.name + ".json").read_text())
            assert content["sha256"] == sha256_of(path)
            assert content["bytes"] == path.stat().st_size
        assert card["image_tokens"] > 0


def test_large_weights_are_saved_next_to_the_network(
    cache, originals, rgb, folders, tmp_path, monkeypatch
):
    monkeypatch.setattr(vlm_files, "ONE_FILE_BYTES", 10_000)
    words = ["big", "--weights", str(folders["idefics3"]), "--cache", str(tmp_path / "models")]
    assert main(words) == 0
    card = yaml.safe_load((tmp_path / "models" / "big-fp32.yaml").read_text())
    assert {"file": "onnx/decoder_model_merged.onnx_data"} in card["others"]
    onnx_folder = tmp_path / "models" / "big" / "onnx"
    assert (onnx_folder / "decoder_model_merged.onnx").stat().st_size < 100_000
    original, asked = originals["idefics3"]
    chain, shown = OnnxPipeline([onnx_folder / f"{name}.onnx" for name in MAIN]), original.show(rgb)
    logits = chain.logits(asked[0], chain.features(shown.feeds), shown.grid)
    np.testing.assert_allclose(logits, original.logits(asked[0], shown), atol=2e-5)


def test_files_that_miss_the_gate_replace_nothing(folders, photos, tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    models = tmp_path / "models"
    images = ["--validation", str(photos)]
    export = ["my", "--weights", str(folders["smolvlm"]), "--cache", str(models), *images]
    more = ["--cards", str(models), "--calibration", str(photos), "--precision", "q4"]
    quantize = ["my-fp32", "--cache", str(models), *images, *more]

    def files():
        return {path: path.stat().st_mtime_ns for path in models.rglob("*") if path.is_file()}

    assert main(export) == main([*quantize, "--no-gate"]) == 0
    before = files()
    unreachable = {precision: {"cosine": 2.0} for precision in EVERY}
    monkeypatch.setattr(vlm_files, "LIMITS", unreachable)
    assert main(export) == main(quantize) == 1
    assert files() == before


def test_the_weights_digest_is_of_files_of_any_size(tmp_path):
    """Published files are larger than the limit that applies elsewhere."""
    from exporters.hugging_face import weights_sha256

    file = tmp_path / "model.safetensors"
    file.touch()
    nothing = weights_sha256(tmp_path)
    with file.open("r+b") as sparse:
        sparse.truncate(MAX_TEXT_BYTES + 1)
    assert weights_sha256(tmp_path) != nothing


# -- in the service ----------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "precision"), MADE)
def test_the_service_asks_it(cache, monkeypatch, rgb, kind, precision):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(cache))
    card = load_card(f"{name_of(kind)}-{precision}")
    asked = [
        MultipleChoice("Which way? A, B or C", tuple("ABC")),
        MultipleChoice("Is it?", ("Yes", "No")),
    ]
    model = LanguageModel(card, asked)
    for p, one in zip(model.ask("Be brief.", rgb, asked, 60.0), asked, strict=True):
        assert p.shape == (len(one.answers),)
        assert p.sum() == pytest.approx(1.0, abs=1e-5)
    model.close()


@pytest.mark.parametrize("kind", ["qwen2_vl", "qwen3_vl"])
def test_the_service_answers_as_the_model(cache, folders, originals, monkeypatch, rgb, kind):
    """Positions of three numbers, features of the image, DeepStack; a second question reads on."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(cache))
    asked = [MultipleChoice(f"{word}? A, B or C", tuple("ABC")) for word in ("Where", "Which way")]
    service = LanguageModel(load_card(f"{name_of(kind)}-fp32"), asked)
    (original, _), rgb = originals[kind], rgb[:40, :48]
    tokenizer = hugging_face.open_tokenizer(folders[kind] / "tokenizer.json")
    image = tokenizer.token_to_id(tiny_folders.IMAGE[kind])
    letters = [tokenizer.token_to_id(letter) for letter in "ABC"]
    for p, one in zip(service.ask("Be brief.", rgb, asked, 60.0), asked, strict=True):
        parts = ("system: Be brief.user: ", one.question)
        before, after = (tokenizer.encode(part, add_special_tokens=False).ids for part in parts)
        question = Question(tuple(before), tuple(after), (), image)
        logits = original.logits(question, original.show(rgb))[letters]
        np.testing.assert_allclose(p, np.exp(logits) / np.exp(logits).sum(), atol=1e-5)
    service.close()


# -- errors ----------------------------------------------------------------------------------


def test_an_unavailable_precision_names_the_command_to_run(folders, tmp_path, capsys):
    def fails(*words):
        start = ["x", "--weights", str(folders["idefics3"]), "--cache", str(tmp_path / "cache")]
        assert main([*start, *words]) == 1
        assert not list((tmp_path / "cache").glob("*.yaml"))
        return capsys.readouterr().err.strip().splitlines()[-1]

    assert "then run `edge models export x-fp32 --quantize --precision P" in fails(
        "--precision", "q4"
    )


def test_a_vocabulary_without_letters_is_an_error(folders, tmp_path):
    content = json.loads((folders["idefics3"] / "tokenizer.json").read_text())
    del content["model"]["vocab"]["C"]
    (tmp_path / "tokenizer.json").write_text(json.dumps(content))
    with pytest.raises(ExportError, match="no token for the letter 'C'"):
        questions(tmp_path, 5)
