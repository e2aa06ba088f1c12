"""The net of the choice scorer: what it may depend on."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (extra `export`)")

pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

from exporters.choice.net import FAR, GRID_HW, MARK, NEAR, ChoiceNet, cell_centres, tents  # noqa: E402

KINDS, CELLS = 5, GRID_HW[0] * GRID_HW[1]


@pytest.fixture(scope="module")
def net() -> ChoiceNet:
    torch.manual_seed(0)
    return ChoiceNet(KINDS, width=16, heads=2).eval().requires_grad_(False)


def asked(views: int = 2, targets: int = 3, marks: int = 4):
    g = torch.Generator().manual_seed(1)

    def some(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=g)

    images = (some(views, NEAR, *GRID_HW), some(views, FAR, *GRID_HW), some(views, KINDS, *GRID_HW))
    at = some(views, marks, MARK)
    at[..., 4] = 1.0
    return images, some(views, targets, CELLS), some(views, targets, 64), at


def answer(net, images, *rest):
    return net(net.read(*images), *rest)


def test_a_place_is_read_from_its_cells_with_weights_that_sum_to_one():
    centres = cell_centres()
    torch.testing.assert_close(tents(centres), torch.eye(CELLS), atol=1e-5, rtol=0.0)
    between = tents((centres[:1] + centres[1:2]) / 2)
    torch.testing.assert_close(between[0, :2], torch.tensor([0.5, 0.5]))
    outside = tents(torch.tensor([[-1.0, 2.0]]))
    torch.testing.assert_close(outside.sum(-1), torch.ones(1))


def test_without_marks_only_elsewhere_is_left(net):
    images, target, text, marks = asked()
    logits, scene = answer(net, images, target, text, torch.zeros_like(marks))
    assert logits.shape == (2, 3, 5)
    assert scene.shape == (2, 3)
    torch.testing.assert_close(logits.softmax(-1)[..., -1], torch.ones(2, 3))


def test_marks_that_are_not_there_change_nothing(net):
    images, target, text, marks = asked()
    fewer, scene = answer(net, images, target, text, marks[:, :2])
    marks[:, 2:] = 0.0
    logits, same = answer(net, images, target, text, marks)
    torch.testing.assert_close(logits[..., [0, 1, 4]], fewer, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(scene, same, atol=1e-5, rtol=1e-4)


def test_the_order_of_marks_views_and_targets_is_only_an_order(net):
    images, target, text, marks = asked()
    logits, scene = answer(net, images, target, text, marks)
    turned = tuple(x.flip(0) for x in images)
    other, whole = answer(
        net, turned, target.flip(0, 1), text.flip(0, 1), marks.flip(0, 1)
    )  # fmt: skip
    expected = torch.cat([logits[..., :4].flip(-1), logits[..., 4:]], -1).flip(0, 1)
    torch.testing.assert_close(other, expected, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(whole, scene.flip(0, 1), atol=1e-5, rtol=1e-4)
