"""The network of the choice scorer: which inputs change its outputs; its training's files."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (extra `export`)")

pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

from edge.perception.runtime.card_types import MARK_FIELDS, OTHERS_FIELDS  # noqa: E402
from exporters.training.choice import features  # noqa: E402
from exporters.training.choice.__main__ import main  # noqa: E402
from exporters.training.choice.net import (  # noqa: E402
    GRID_HW,
    NECK16_CHANNELS,
    NECK32_CHANNELS,
    ChoiceNet,
    bilinear_weights,
    cell_centres,
)
from exporters.training.choice.training import _with_hidden  # noqa: E402

KINDS, CELLS = 5, GRID_HW[0] * GRID_HW[1]


@pytest.fixture(scope="module")
def net() -> ChoiceNet:
    torch.manual_seed(0)
    return ChoiceNet(KINDS, width=16, heads=2).eval().requires_grad_(False)


def asked(views: int = 2, targets: int = 3, marks: int = 4):
    g = torch.Generator().manual_seed(1)

    def some(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=g)

    channels = (NECK16_CHANNELS, NECK32_CHANNELS, KINDS)
    images = tuple(some(views, n, *GRID_HW) for n in channels)
    at = some(views, marks, MARK_FIELDS)
    at[..., -1] = 1.0
    others = some(views, OTHERS_FIELDS)
    return images, some(views, targets, CELLS), some(views, targets, 64), at, others


def answer(net, images, *rest):
    return net(net.read(*images), *rest)


def test_bilinear_weights_of_a_place_sum_to_one():
    centres = cell_centres()
    torch.testing.assert_close(bilinear_weights(centres), torch.eye(CELLS), atol=1e-5, rtol=0.0)
    between = bilinear_weights((centres[:1] + centres[1:2]) / 2)
    torch.testing.assert_close(between[0, :2], torch.tensor([0.5, 0.5]))
    outside = bilinear_weights(torch.tensor([[-1.0, 2.0]]))
    torch.testing.assert_close(outside.sum(-1), torch.ones(1))


def test_without_marks_elsewhere_has_all_probability(net):
    images, target, text, marks, others = asked()
    logits, scene = answer(net, images, target, text, torch.zeros_like(marks), others)
    assert logits.shape == (2, 3, 5)
    assert scene.shape == (2, 3)
    torch.testing.assert_close(logits.softmax(-1)[..., -1], torch.ones(2, 3))


def test_absent_marks_change_nothing(net):
    images, target, text, marks, others = asked()
    fewer, scene = answer(net, images, target, text, marks[:, :2], others)
    marks[:, 2:] = 0.0
    logits, same = answer(net, images, target, text, marks, others)
    torch.testing.assert_close(logits[..., [0, 1, 4]], fewer, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(scene, same, atol=1e-5, rtol=1e-4)


def test_permuted_inputs_permute_the_outputs(net):
    images, target, text, marks, others = asked()
    logits, scene = answer(net, images, target, text, marks, others)
    turned = tuple(x.flip(0) for x in images)
    other, whole = answer(
        net, turned, target.flip(0, 1), text.flip(0, 1), marks.flip(0, 1), others.flip(0)
    )  # fmt: skip
    expected = torch.cat([logits[..., :4].flip(-1), logits[..., 4:]], -1).flip(0, 1)
    torch.testing.assert_close(other, expected, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(whole, scene.flip(0, 1), atol=1e-5, rtol=1e-4)


def test_elsewhere_goes_by_the_frontiers_without_a_mark(net):
    images, target, text, marks, others = asked()
    logits, _ = answer(net, images, target, text, marks, others)
    more, _ = answer(net, images, target, text, marks, 5.0 * others)
    assert not torch.allclose(logits[..., -1], more[..., -1], atol=1e-3)


def test_hidden_marks_count_as_unmarked_frontiers():
    marks = np.zeros((3, 2, MARK_FIELDS), np.float32)
    marks[:, :, 4:] = [[3.0, 9.0, 1.0], [5.0, 2.0, 1.0]]  # path, gain, there
    others = np.array([[0, 0, 0], [2, 4, 5], [0, 0, 0]], np.float32)
    hidden = np.array([[True, True], [True, False], [False, False]])
    found = _with_hidden(others, marks, hidden)
    np.testing.assert_allclose(found, [[2, 3, 9], [3, 3, 9], [0, 0, 0]])


def test_stored_features_are_those_of_their_detector(tmp_path, monkeypatch):
    class Trunk:
        def __init__(self, key: str, value: int) -> None:
            self.key, self._value = key, value

        def read(self, rgb):
            return (np.full((1, *features.GRID_HW), self._value),) * 3

    class OneView:
        def rgb(self, k):
            return np.zeros((4, 4, 3), np.uint8)

        def __len__(self):
            return 1

    monkeypatch.setattr(features, "load_views", lambda paths: OneView())
    for key, value in (("old", 1), ("new", 2)):
        found = features.make_features([tmp_path / "7.npz"], Trunk(key, value))
        assert found.evidence.max() == value
    monkeypatch.setattr(features, "load_views", None)  # stored: no view is read again
    assert features.make_features([tmp_path / "7.npz"], Trunk("old", 3)).evidence.max() == 1


def test_houses_that_are_held_out_cannot_be_trained_on(tmp_path, capsys):
    assert main(["--out", str(tmp_path), "--houses", "1001"]) == 1
    assert "--houses: got 1001; give at most 1000" in capsys.readouterr().err
