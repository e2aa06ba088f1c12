"""YOLOE-11 of random weights: prompts as an input give what Ultralytics folds into the network."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import yaml

pytest.importorskip("torch", reason="torch is not installed (extra `export`)")
pytest.importorskip("ultralytics", reason="ultralytics is not installed (extra `export`)")
pytest.importorskip("onnxslim", reason="onnxslim is not installed (extra `export`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")

import onnx
import tiny_folders
import torch

from edge.host import resources
from edge.perception.embedding.clip import ClipTextEncoder
from edge.perception.runtime.cards import load_card, made_parity, read_card, verify_file
from exporters.__main__ import main
from exporters.files import sha256_of
from exporters.images import list_images, load_input
from exporters.onnx_format import cpu_session

pytestmark = [pytest.mark.export, pytest.mark.timeout(600)]

HW = (128, 160)
PRECISIONS = ("fp16", "int8-cpu", "int8-trt")
TEXT = "mobileclip-b-text-fp32"


class TinyText(torch.nn.Module):
    """A text encoder that takes the mean of its tokens' rows."""

    def __init__(self, tokens):
        super().__init__()
        self.rows = torch.nn.Embedding(tokens, 512)

    def forward(self, tokens):
        return torch.nn.functional.normalize(self.rows(tokens).mean(dim=1), dim=-1)


def random_yoloe(images):
    """Return YOLOE-11-N, S in half its width, of random weights that find something."""
    from ultralytics.nn.tasks import YOLOESegModel

    torch.manual_seed(0)
    torch.set_num_threads(1)  # more would only wait for each other
    model = YOLOESegModel("yoloe-11n-seg.yaml", verbose=False)
    head = model.model[-1]
    with torch.no_grad():
        head.reprta.m.w3.weight.normal_(std=0.02)  # it begins with zeros, which do nothing
        for contrast in head.cv4:
            contrast.logit_scale.fill_(0.2)
            contrast.bias.fill_(-4.0)
        norms = [m for m in model.modules() if isinstance(m, torch.nn.BatchNorm2d)]
        for norm in norms:
            norm.momentum = 1.0  # each layer's values get mean 0 and variance 1
        model.train()
        model.predict(images, tpe=torch.randn(len(images), 3, 512))
    return model.eval()


@pytest.fixture(scope="module")
def published(photos, tmp_path_factory):
    """Return a folder with the checkpoint, the text encoder, and cards of a small image."""
    root = tmp_path_factory.mktemp("published")
    images = np.concatenate([load_input(path, HW) for path in list_images(photos)])
    torch.save({"model": random_yoloe(torch.from_numpy(images))}, root / "yoloe.pt")
    tokens = tiny_folders.write_tokenizer(root, lowercase=True)
    example = torch.zeros(2, 77, dtype=torch.int64)
    torch.jit.trace(TinyText(tokens).eval(), example).save(str(root / "text.ts"))
    for precision in ("fp32", *PRECISIONS):
        name = f"yoloe-11s-480x640-{precision}.yaml"
        card = yaml.safe_load((resources.data_dir("models") / name).read_text())
        card["input"] = dict(zip(("height", "width"), HW, strict=True))
        (root / name).write_text(yaml.safe_dump(card))
    return root


@pytest.fixture(scope="module")
def cache(published, photos, tmp_path_factory):
    """Return the `$EDGE_CACHE_DIR` after the export of the text encoder and all detectors."""
    root = tmp_path_factory.mktemp("cache")
    models = root / "models"
    models.mkdir()
    tokenizer = (published / "tokenizer.json").read_bytes()
    (models / "mobileclip-b-tokenizer.json").write_bytes(tokenizer)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGE_CACHE_DIR", str(root))
        text, weights = published / "text.ts", published / "yoloe.pt"
        common = ["--cache", str(models), "--sha256"]
        assert main([TEXT, "--weights", str(text), *common, sha256_of(text)]) == 0
        common += [sha256_of(weights), "--cards", str(published)]
        common += ["--calibration", str(photos), "--validation", str(photos)]
        fp32 = "yoloe-11s-480x640-fp32"
        assert main([fp32, "--weights", str(weights), *common]) == 0
        for precision in PRECISIONS:
            assert main([f"yoloe-11s-480x640-{precision}", *common, "--no-gate"]) == 0
    return root


def test_prompts_as_an_input_are_prompts_folded_into_the_network(models, published, photos):
    image = load_input(list_images(photos)[0], HW)
    text = ClipTextEncoder(load_card(TEXT)).embed(["chair", "sofa", "fire extinguisher"])
    session = cpu_session(models / "yoloe-11s-480x640-fp32.onnx")
    boxes, scores = session.run(None, {"images": image, "txt_feats": text})
    model = torch.load(published / "yoloe.pt", weights_only=False)["model"].float().eval()
    head = model.model[-1]
    folded = copy.deepcopy(model)
    with torch.inference_mode():
        prompts = head.get_tpe(torch.from_numpy(text))
    folded.model[-1].nc = 3
    folded.model[-1].no = 3 + 4 * head.reg_max
    folded.model[-1].fuse(prompts)
    with torch.inference_mode():
        found = folded.predict(torch.from_numpy(image), tpe=prompts)
    while not torch.is_tensor(found):
        found = found[0]
    x, y, w, h = found[0, :4].numpy()
    wanted = np.stack((x - w / 2, y - h / 2, x + w / 2, y + h / 2), axis=1)
    np.testing.assert_allclose(boxes[0], wanted, atol=1e-2)
    np.testing.assert_allclose(scores[0], found[0, 4:7].numpy().T, atol=1e-4)
    assert np.ptp(scores) > 0.1


@pytest.mark.parametrize(("precision", "least"), [("fp32", 1.0), ("fp16", 0.9)])
def test_float_files_find_the_boxes_of_the_original(models, precision, least):
    parity = made_parity(load_card(f"yoloe-11s-480x640-{precision}"))
    assert parity.images > 0
    assert parity.recall >= least


@pytest.mark.parametrize("precision", ["int8-cpu", "int8-trt"])
def test_int8_files_are_sound_and_keep_the_head(models, published, precision):
    """Random layers multiply the error of each other, so the number of boxes is no measure."""
    path = models / f"yoloe-11s-480x640-{precision}.onnx"
    verify_file(read_card(published / f"yoloe-11s-480x640-{precision}.yaml"), path)
    graph = onnx.load(path).graph
    made_by = {output: node for node in graph.node for output in node.output}

    def is_quantized(name):
        (node,) = (node for node in graph.node if node.name == name)
        return made_by[node.input[1]].op_type == "DequantizeLinear"

    assert is_quantized("/model.4/cv1/conv/Conv")
    assert is_quantized("/model.23/cv3.0/cv3.0.0/cv3.0.0.0/conv/Conv")  # depthwise
    for name in ("/model.23/reprta/m/w12/MatMul", "/model.0/conv/Conv"):
        (node,) = (node for node in graph.node if node.name == name)
        source = made_by.get(node.input[1])
        assert source is None or source.op_type != "DequantizeLinear"


def test_the_head_keeps_its_bits(models):
    half = onnx.load(models / "yoloe-11s-480x640-fp16.onnx")
    types = {i.name: i.data_type for i in half.graph.initializer}
    weights = {n.name: types[n.input[1]] for n in half.graph.node
               if n.op_type in ("Conv", "MatMul") and n.input[1] in types}  # fmt: skip
    assert weights["/model.23/reprta/m/w12/MatMul"] == onnx.TensorProto.FLOAT
    assert weights["/model.4/cv1/conv/Conv"] == onnx.TensorProto.FLOAT16


def test_weights_without_a_known_hash_are_not_loaded(published, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    words = ["yoloe-11s-480x640-fp32", "--weights", str(published / "yoloe.pt")]
    cache = ["--cache", str(tmp_path)]
    assert main([*words, *cache]) == 1
    assert f"{TEXT}.onnx: model {TEXT} is not there" in capsys.readouterr().err
    tiny_folders.write_tokenizer(tmp_path, lowercase=True)
    (tmp_path / "tokenizer.json").rename(tmp_path / "mobileclip-b-tokenizer.json")
    text = [TEXT, "--weights", str(published / "text.ts"), *cache]
    assert main(text) == 1
    assert "its card knows no hash of the weights; give --sha256" in capsys.readouterr().err
    assert main([*text, "--sha256", "0" * 64]) == 1
    assert "text.ts: SHA-256 is" in capsys.readouterr().err
    wrong = published / "yoloe.pt"
    assert main([TEXT, "--weights", str(wrong), *cache, "--sha256", sha256_of(wrong)]) == 1
    assert "not a TorchScript file" in capsys.readouterr().err
