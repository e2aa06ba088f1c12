"""Image and text towers from Hugging Face folders: the originals' embeddings, in the service."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed (extra `transformers`)")
pytest.importorskip("transformers", reason="transformers is not installed (extra `transformers`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")
pytest.importorskip("onnxscript", reason="onnxscript is not installed (extra `transformers`)")

import onnx
import tiny_folders
import torch
import transformers

from edge.config import PerceptionConfig
from edge.host import resources
from edge.models.check import check_model
from edge.perception.embedding.clip import ClipImageEncoder, ClipTextEncoder
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.runtime.cards import load_card
from edge.perception.scoring.similarity import SENTENCE, make_similarity
from exporters.__main__ import main
from exporters.clip import image_preprocess
from exporters.encoder_parity import compare, rank_agreement
from exporters.files import ExportError
from exporters.images import read_rgb

pytestmark = [pytest.mark.export, pytest.mark.timeout(600)]

PRECISIONS = ("fp32", "fp16", "int8-cpu")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    torch.set_num_threads(1)  # more would only wait for each other
    root = tmp_path_factory.mktemp("published")
    write = {"clip": tiny_folders.write_clip, "siglip": tiny_folders.write_siglip}
    return {kind: make(root / kind) for kind, make in write.items()}


@pytest.fixture(scope="module")
def cache(folders, photos, tmp_path_factory):
    """Return the `$EDGE_CACHE_DIR` after exporting both in all precisions."""
    root = tmp_path_factory.mktemp("cache")
    for kind, folder in folders.items():
        pictures = ["--calibration", photos, "--validation", photos, "--no-gate"]
        words = [f"my-{kind}", "--weights", folder, "--cache", root / "models", *pictures]
        assert main([*map(str, words), "--precision", *PRECISIONS]) == 0
    return root


@pytest.fixture(scope="module")
def rgb(photos):
    return read_rgb(sorted(photos.iterdir())[0])


# -- figures -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reference", "candidate", "share"),
    [
        ([[1.0], [2.0], [3.0]], [[0.1], [0.2], [0.3]], 1.0),
        ([[1.0], [2.0], [3.0]], [[3.0], [2.0], [1.0]], 0.0),
        ([[1.0], [2.0], [3.0]], [[1.0], [3.0], [2.0]], 2 / 3),
        ([[1.0], [1.0], [3.0]], [[2.0], [1.0], [3.0]], 1.0),  # a tie is no order
        ([[1.0, 4.0], [2.0, 3.0]], [[1.0, 3.0], [2.0, 4.0]], 0.5),
    ],
)
def test_rank_agreement_counts_pairs(reference, candidate, share):
    assert rank_agreement(np.array(reference), np.array(candidate)) == pytest.approx(share)


def test_invalid_embeddings_cannot_be_compared():
    assert np.isnan(rank_agreement(np.ones((1, 3)), np.ones((1, 3))))
    with pytest.raises(ExportError, match="candidate's embeddings are zero or not finite"):
        compare(np.ones((1, 4)), np.full((1, 4), np.nan))


def test_embeddings_are_compared_by_direction():
    report = compare(np.array([[1.0, 0.0], [0.0, 2.0]]), np.array([[3.0, 0.0], [1.0, 1.0]]))
    assert report.cosine == pytest.approx(2**-0.5)
    assert report.for_card("torch")["rank_agreement"] is None


# -- towers ------------------------------------------------------------------------------------


def original(folder, kind):
    name = {"clip": "CLIPModel", "siglip": "SiglipModel"}[kind]
    return getattr(transformers, name).from_pretrained(folder).eval()


def features(found):
    """(n, d) unit rows; newer versions of transformers wrap them."""
    rows = getattr(found, "pooler_output", found).detach().numpy()
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", ["clip", "siglip"])
def test_texts_embed_as_the_original_embeds_them(models, folders, kind):
    encoder = ClipTextEncoder(load_card(f"my-{kind}-text-fp32"))
    texts = ["Seems like there is a chair ahead.", "sofa", ""]
    tokenizer = transformers.PreTrainedTokenizerFast(
        tokenizer_file=str(models / f"my-{kind}-tokenizer.json"), pad_token=tiny_folders.PAD
    )
    context = encoder.card.tokenizer.context
    tokens = tokenizer(texts, padding="max_length", max_length=context, return_tensors="pt")
    with torch.inference_mode():
        wanted = features(original(folders[kind], kind).get_text_features(tokens["input_ids"]))
    np.testing.assert_allclose(encoder.encode(texts), wanted, atol=2e-6)


@pytest.mark.parametrize("kind", ["clip", "siglip"])
def test_image_embeddings_agree_with_the_original(models, folders, kind, rgb):
    encoder = ClipImageEncoder(load_card(f"my-{kind}-image-fp32"), ("CPUExecutionProvider",), 1)
    from edge.perception.embedding.clip import pixels_of

    pixels = torch.from_numpy(pixels_of(rgb, encoder.card))
    with torch.inference_mode():
        wanted = features(original(folders[kind], kind).get_image_features(pixels))
    np.testing.assert_allclose(encoder.embed(rgb), wanted[0], atol=2e-6)


def test_siglip_ignores_case_and_attends_to_padding(models):
    card = load_card("my-siglip-text-fp32")
    encoder = ClipTextEncoder(card)
    np.testing.assert_array_equal(encoder.encode(["CHAIR"]), encoder.encode(["chair"]))
    other = card.model_copy(update={"tokenizer": card.tokenizer.model_copy(update={"pad": 5})})
    moved = ClipTextEncoder(other).encode(["chair"]) @ encoder.encode(["chair"]).T
    assert moved[0, 0] < 0.999


def test_int8_quantizes_only_the_large_matrices(models):
    graph = onnx.load(models / "my-clip-image-int8-cpu.onnx").graph
    types = {init.name: init.data_type for init in graph.initializer}
    made_by = {name: node for node in graph.node for name in node.output}
    products = [n for n in graph.node if n.op_type == "MatMul" and "self_attn/MatMul" not in n.name]
    assert len(products) == 2 * 6 + 1, "the layers', and the projection"
    for node in products:
        left, right = (made_by[name] for name in node.input)
        assert left.op_type == right.op_type == "DequantizeLinear"
        assert types[right.input[0]] == onnx.TensorProto.INT8
    quantized = {made_by.get(n.input[0], n).op_type for n in graph.node if "Quantize" in n.op_type}
    assert not quantized & {"Softmax", "MatMul"}


@pytest.mark.parametrize("kind", ["clip", "siglip"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_step_keeps_its_parity(models, kind, precision):
    limits = {"fp32": 0.999999, "fp16": 0.99999, "int8-cpu": 0.999}
    card = load_card(f"my-{kind}-{precision}")
    for name in (card.image_encoder, card.text_encoder):
        sidecar = json.loads((models / f"{name}.onnx.json").read_text())
        assert sidecar["parity"]["cosine"] > limits[precision]
        assert sidecar["parity"]["reference"] == "torch"
        assert sidecar["weights_sha256"]
        assert ": ok (hash, interface, embeddings of" in check_model(load_card(name))


def perception(similarity):
    return PerceptionConfig(similarity=similarity, detector={"kind": "sim"})


@pytest.mark.parametrize("kind", ["clip", "siglip"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_pair_scores_in_the_service(models, folders, kind, precision, rgb):
    card = load_card(f"my-{kind}-{precision}")
    scorer = make_similarity(card, perception(card.name), ["chair"])
    scores = scorer.score(rgb, ["chair", "sofa"])
    original_image = ClipImageEncoder(
        load_card(f"my-{kind}-image-fp32"), ("CPUExecutionProvider",), 1
    )
    original_text = ClipTextEncoder(load_card(f"my-{kind}-text-fp32"))
    wanted = original_text.encode([SENTENCE.format(w) for w in ("chair", "sofa")])
    np.testing.assert_allclose(scores, wanted @ original_image.embed(rgb), atol=0.02)


def test_a_tower_of_the_detectors_family_encodes_its_prompts(folders, tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    words = ["own", "--weights", str(folders["clip"]), "--family", "clip-vit-b-32"]
    assert main([*words, "--cache", str(resources.models_dir())]) == 0

    class Detector:
        name, text_encoder, text_dim = "detector", None, 48

    encoder = make_text_encoder(Detector, None)
    assert encoder.card.name == "own-text-fp32"
    assert encoder.embed(["a chair", "sofa"]).shape == (1, 2, 48)


# -- errors ----------------------------------------------------------------------------------


def test_an_unusable_folder_is_an_error_of_one_line(folders, tmp_path, capsys):
    def fails(*words, name="x"):
        code = main([name, "--weights", *map(str, words), "--cache", str(tmp_path / "cache")])
        (line,) = capsys.readouterr().err.strip().splitlines()[-1:]
        assert code == 1
        assert not list((tmp_path / "cache").glob("*.yaml"))
        return line

    empty = tmp_path / "empty"
    empty.mkdir()
    assert "config.json: cannot be read" in fails(empty)
    (empty / "config.json").write_text('{"model_type": "bert"}')
    assert "model_type 'bert' cannot be exported (choices: clip" in fails(empty)
    (empty / "config.json").write_text('{"model_type": "clip"}')
    assert "no *.safetensors" in fails(empty)
    assert "use only lower-case letters" in fails(folders["clip"], name="My CLIP")
    assert "--calibration is missing" in fails(folders["clip"], "--precision", "fp16")
    says = "no precision 'int4' for image and text encoders"
    assert says in fails(folders["clip"], "--precision", "int4")


def test_missing_weights_are_an_error(folders, tmp_path, capsys):
    from safetensors.torch import load_file, save_file

    folder = shutil.copytree(folders["clip"], tmp_path / "cut")
    weights = load_file(folder / "model.safetensors")
    del weights["visual_projection.weight"]
    save_file(weights, folder / "model.safetensors", metadata={"format": "pt"})
    assert main(["x", "--weights", str(folder), "--cache", str(tmp_path / "cache")]) == 1
    assert "1 weights are missing (visual_projection.weight" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["clip", "idefics3"])
def test_a_foreign_tokenizer_is_an_error(folders, tmp_path, capsys, kind):
    folder = tiny_folders.write_vlm(tmp_path / kind, kind) if kind == "idefics3" else None
    folder = folder or shutil.copytree(folders[kind], tmp_path / kind)
    content = (folder / "tokenizer.json").read_text()
    (folder / "tokenizer.json").write_text(re.sub(r'("a": )\d+', r"\g<1>5000", content))
    assert main(["x", "--weights", str(folder), "--cache", str(tmp_path / "cache")]) == 1
    assert (
        "tokenizer.json: has a token 5000, but the model only tokens 0 to "
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"size": "large"}, "size: "),
        ({"size": {"shortest_edge": 40}}, "crop_size must equal size"),
        ({"do_center_crop": False}, "do_center_crop must be true"),
    ],
)
def test_a_preparation_of_images_that_the_service_lacks_is_refused(
    folders, tmp_path, changed, says
):
    content = json.loads((folders["clip"] / "preprocessor_config.json").read_text())
    (tmp_path / "preprocessor_config.json").write_text(json.dumps(content | changed))
    with pytest.raises(ExportError, match=says):
        image_preprocess(tmp_path)
