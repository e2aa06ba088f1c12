"""Segmenters with box prompts, in miniature: the real ones cannot be had everywhere."""

from __future__ import annotations

import numpy as np
import pytest
import tiny_sam

from edge import config
from edge.cli.main import main
from edge.host import resources
from edge.models.make import load_single_file_card
from edge.perception.masks.sam import SamSegmenter
from edge.perception.masks.segmenter import Deadline
from edge.perception.runtime.cards import ModelError, load_card
from edge.types import MASK_SIDE

for package in ("onnxruntime", "onnx"):
    pytest.importorskip(package)


@pytest.fixture
def put(cards):
    """put(layout, **changes): its files and card."""

    def write(name, **changes):
        return tiny_sam.write(resources.models_dir(), cards, name, **changes)

    return write


def opened(name, **settings):
    return SamSegmenter(config.SegmenterOnnx(model=name, **settings))


def segment(segmenter, rgb, *boxes, deadline=None):
    boxes = np.array(boxes, np.float32).reshape(-1, 4)
    out = np.zeros((len(boxes), MASK_SIDE, MASK_SIDE), np.bool_)
    return segmenter.segment(rgb, boxes, out, Deadline(deadline)), out


def bright(x0, y0, x1, y1, hw=(96, 160)):
    rgb = np.zeros((*hw, 3), np.uint8)
    rgb[y0:y1, x0:x1] = 255
    return rgb


@pytest.mark.parametrize("hw", [(96, 160), (160, 96), (64, 64)])
@pytest.mark.parametrize("layout", tiny_sam.LAYOUTS)
def test_a_mask_covers_its_object(put, layout, hw):
    put(layout)
    rgb, box = bright(20, 10, 40, 40, hw), (20, 10, 60, 40)
    done, out = segment(opened(layout), rgb, box, (0, 50, 20, 60))
    assert done == 2
    left, right = out[0, :, : MASK_SIDE // 2], out[0, :, MASK_SIDE // 2 :]
    assert left.mean() > 0.8
    assert right.mean() < 0.15
    assert not out[1].any()  # where nothing is bright


@pytest.mark.parametrize("layout", tiny_sam.LAYOUTS)
def test_an_image_of_another_size_leaves_nothing_behind(put, layout):
    put(layout)
    segmenter = opened(layout)
    segment(segmenter, np.full((160, 160, 3), 255, np.uint8), (0, 0, 160, 160))
    for rgb in (bright(20, 10, 40, 40), bright(20, 10, 40, 40, (160, 90))):
        one, other = (segment(s, rgb, (10, 5, 60, 50))[1] for s in (segmenter, opened(layout)))
        np.testing.assert_array_equal(one, other)
        assert one.any()


def test_without_boxes_no_image_is_encoded(put):
    put("nano-sam", slow=True)
    assert segment(opened("nano-sam"), bright(0, 0, 9, 9))[0] == 0


def test_a_slow_image_is_given_up_at_the_deadline(put):
    put("nano-sam", slow=True)
    segmenter = opened("nano-sam")
    for deadline in (-1.0, 0.05):
        done, out = segment(segmenter, bright(0, 0, 9, 9), (0, 0, 9, 9), deadline=deadline)
        assert done == 0
        assert not out.any()
    dark = np.zeros((8, 8, 3), np.uint8)
    assert segment(segmenter, dark, (0, 0, 8, 8), deadline=60.0)[0] == 1  # and it goes on


def test_two_exports_do_not_go_together(put):
    sam2 = put("sam2-tiny")
    put("mobile-sam", encoder=sam2["encoder"])
    with pytest.raises(ModelError, match="take both files from one export"):
        opened("mobile-sam")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"providers": ()}, "perception.segmenter.providers: empty"),
        ({"providers": ("NoProvider",)}, "perception.segmenter.providers: 'NoProvider' is not"),
        ({"providers": ("tensorrt",)}, "perception.segmenter.providers: 'tensorrt' runs only"),
    ],
)
def test_a_provider_that_cannot_be_had(put, settings, message):
    put("nano-sam")
    with pytest.raises(ModelError, match=message):
        opened("nano-sam", **settings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda card: {"encoder": card["decoder"]}, "must have one input"),
        (lambda card: {"decoder": card["encoder"]}, "must have features"),
        (lambda card: {"input": {"height": 64, "width": 64}}, "must have one input"),
    ],
)
def test_a_model_with_other_inputs_is_refused(put, change, message):
    put("nano-sam", **change(put("nano-sam")))
    with pytest.raises(ModelError, match=message):
        opened("nano-sam")


# -- the commands ---------------------------------------------------------------------------------


def test_both_files_are_checked(put, capsys):
    layout = next(iter(tiny_sam.LAYOUTS))
    put(layout)
    assert main(["models", "list", "--check", layout]) == 0
    features, masks = capsys.readouterr().out.splitlines()
    assert features.startswith(f"{layout}: ok (hash, interface, features (1, ")
    assert masks.startswith(f"{layout}: ok (hash, interface, masks (1, ")


def test_a_damaged_decoder_is_reported(put, capsys):
    card = put("nano-sam")
    path = resources.models_dir() / card["decoder"]["file"]
    path.write_bytes(path.read_bytes() + b"\0")
    assert main(["models", "list", "--check", "nano-sam"]) == 1
    told = capsys.readouterr().err
    assert str(path) in told
    assert "damaged or another model" in told


def test_missing_files_are_pulled_from_their_sources(put, capsys, tmp_path):
    card, sources = put("nano-sam"), []
    for part in (card["encoder"], card["decoder"]):
        path = tmp_path / part["file"]
        (resources.models_dir() / part["file"]).rename(path)
        url = f"https://example.org/{part['file']}"
        sources.append({"kind": "url", "url": url, "sha256": part["sha256"]})
    put("nano-sam", sources=sources)
    for part in (card["encoder"], card["decoder"]):
        (resources.models_dir() / part["file"]).unlink()
    assert main(["models", "list"]) == 0
    assert "missing" in capsys.readouterr().out
    assert main(["models", "pull", "nano-sam", "--offline", "--from", str(tmp_path)]) == 0
    assert all(file.is_here() for file in load_card("nano-sam").files)


def test_a_command_for_one_file_names_both(put):
    put("nano-sam")
    with pytest.raises(ModelError, match=r"two files, nano-sam-encoder.onnx and nano-sam-decoder"):
        load_single_file_card("nano-sam")
