"""The small detector learns, and its ONNX files say what the network says."""

from __future__ import annotations

from functools import partial
from itertools import islice, pairwise

import numpy as np
import pytest

pytestmark = pytest.mark.export
torch = pytest.importorskip("torch", reason="torch is not installed (extra `export`)")
pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

from edge.perception.onnx_file import read_onnx  # noqa: E402
from exporters.files import ExportError  # noqa: E402
from exporters.mini import batches, evaluate, export, loss, training  # noqa: E402
from exporters.mini.net import STRIDES, MiniDetector, anchor_points  # noqa: E402
from exporters.mini.views import make_frames  # noqa: E402

HW = (64, 96)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    return make_frames(range(4), 2, tmp_path_factory.mktemp("data"))


def plan(steps: int, **changes) -> training.Plan:
    return training.Plan(
        stages=((steps, HW, 2),),
        batch=4,
        warm_up=5,
        keep_every=5,
        **changes,
    )


def truth(boxes, answers=1) -> loss.Truth:
    boxes = torch.tensor(boxes, dtype=torch.float32)[None]
    said = torch.full((1, boxes.shape[1], 1), answers, dtype=torch.int8)
    taught = torch.ones(boxes.shape[:2], dtype=torch.bool)
    return loss.Truth(boxes, taught, said, torch.zeros_like(said, dtype=torch.bool))


def test_the_rate_climbs_and_falls():
    shape = training.Plan(stages=((60, HW, 0), (40, HW, 0)), warm_up=10)
    rates = [training._rate(step, shape) for step in range(120)]
    assert rates[0] == pytest.approx(0.1)
    assert rates[10] == pytest.approx(1.0)
    assert all(a > b for a, b in pairwise(rates[10:101]))
    assert rates[100:] == [pytest.approx(0.01)] * 20


def test_the_shipped_models_plan_has_sizes_that_the_network_takes_and_ends_at_its_own():
    steps = training.Plan().steps
    assert len(steps) == sum(count for count, *_ in training.Plan().stages)
    assert steps[-1][0] == training.FULL_HW
    assert all(side % STRIDES[-1] == 0 for hw, _ in set(steps) for side in hw)


def test_anchors_lie_in_their_cells():
    points, stride = anchor_points(*HW)
    assert len(points) == sum(HW[0] // s * (HW[1] // s) for s in STRIDES)
    assert points.min() == 4
    assert (points[:, 0] < HW[1]).all()
    assert (points[:, 1] < HW[0]).all()
    assert sorted(set(stride[:, 0].tolist())) == list(STRIDES)


def test_an_empty_picture_has_no_owner_and_a_finite_loss():
    points, stride = anchor_points(*HW)
    n = len(points)
    nothing = truth(np.zeros((1, 4)), 0)
    nothing.taught[:] = False
    box = torch.zeros(1, n, 4, 8, requires_grad=True)
    decoded = torch.cat([points - stride, points + stride], -1)[None] + box.sum() * 0
    logits = torch.full((1, n, 1), -6.0, requires_grad=True)
    owner, quality = loss.assign(logits.sigmoid(), decoded, points, nothing)
    assert (owner == -1).all()
    assert (quality == 0).all()
    total, _ = loss.detection_loss(box, decoded, logits, points, stride, nothing)
    total.backward()
    assert torch.isfinite(total)


def test_anchors_inside_a_box_answer_for_it_and_no_others():
    points, stride = anchor_points(*HW)
    there = truth([[20.0, 20.0, 60.0, 70.0]])
    decoded = torch.cat([points - 2 * stride, points + 2 * stride], -1)[None]
    scores = torch.full((1, len(points), 1), 0.1)
    owner, quality = loss.assign(scores, decoded, points, there)
    mine = points[owner[0] == 0]
    assert 0 < len(mine) <= loss.TOP_K
    assert (mine[:, 0] > 20).all()
    assert (mine[:, 0] < 60).all()
    assert 0 < quality.max() <= 1


def test_an_unsure_answer_teaches_nothing():
    points, stride = anchor_points(*HW)
    unsure = truth([[20.0, 20.0, 60.0, 70.0]], -1)
    decoded = torch.cat([points - 2 * stride, points + 2 * stride], -1)[None]
    logits = torch.zeros(1, len(points), 1, requires_grad=True)
    box = torch.zeros(1, len(points), 4, 8)
    _, parts = loss.detection_loss(box, decoded, logits, points, stride, unsure)
    inside = ((points > torch.tensor([20, 20])) & (points < torch.tensor([60, 70]))).all(-1)
    assert parts["classes"] == pytest.approx(float((~inside).sum()) * np.log(2), rel=1e-4)


def test_a_cut_keeps_boxes_on_their_pixels(frames):
    rng = np.random.default_rng(1)
    rgb = np.zeros((256, 320, 3), np.uint8)
    rgb[80:160, 100:220] = 255
    boxes = np.array([[100.0, 80.0, 220.0, 160.0]], np.float32)
    for _ in range(20):
        picture, moved, share = batches.cut(rgb, boxes, HW, rng)
        ys, xs = np.nonzero((picture == 255).all(axis=2))
        if share[0] < 0.2:
            continue
        found = [xs.min(), ys.min(), xs.max() + 1, ys.max() + 1]
        np.testing.assert_allclose(moved[0], found, atol=1.6)


def test_a_few_steps_lower_the_loss(frames, tmp_path, caplog):
    caplog.set_level("INFO")
    torch.set_num_threads(1)  # threads that meet at every layer are slow on a busy machine
    stream = list(batches.batches(frames, 4, [(HW, 2)], seed=0))
    model = training.train(frames, plan(25), tmp_path / "a.pt")
    before, after = training.Model(), model
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        first, _ = training._loss(before.train(), stream[0], generator, "cpu")
        last, _ = training._loss(after.train(), stream[0], generator, "cpu")
    assert last < 0.7 * first


def test_training_goes_on_where_it_stopped(frames, tmp_path, monkeypatch):
    torch.set_num_threads(1)
    whole = training.train(frames, plan(10), tmp_path / "whole.pt")
    stream = training.batches
    with monkeypatch.context() as cut_off:
        cut_off.setattr(training, "batches", lambda *a: islice(stream(*a), 5))
        training.train(frames, plan(10), tmp_path / "parts.pt")
    assert torch.load(tmp_path / "parts.pt", weights_only=True)["step"] == 5
    again = training.train(frames, plan(10), tmp_path / "parts.pt")
    assert torch.load(tmp_path / "parts.pt", weights_only=True)["step"] == 10
    for a, b in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b)


def test_two_processes_train_one_model(tmp_path):
    make = partial(make_frames, range(2), 2, tmp_path)
    make()
    training.train_on_cores(make, plan(2), tmp_path / "two.pt", 2)
    _, step, seed = export.load_model(tmp_path / "two.pt")
    assert (step, seed) == (2, 0)


def test_no_checkpoint_is_an_error_that_says_what_to_run(tmp_path):
    with pytest.raises(ExportError, match="train_mini"):
        export.load_model(tmp_path / "none.pt")


def test_the_onnx_files_agree_with_the_network(tmp_path):
    torch.manual_seed(0)
    model = training.Model().eval()
    for module in model.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.normal_(module.bias, std=0.3)
    detector, text = tmp_path / "detector.onnx", tmp_path / "text.onnx"
    export.export_detector(model.detector, detector)
    export.export_encoder(model.encoder, text)
    assert read_onnx(detector).ir <= 10
    tokens = np.array([[1, 0, 0], [2, 3, 0], [5, 1, 6], [35, 12, 1], [7, 0, 2]])
    rows = evaluate.open_model(text).run(None, {"tokens": tokens})[0]
    with torch.no_grad():
        expected = model.encoder(torch.from_numpy(tokens))
        np.testing.assert_allclose(rows, expected, atol=1e-5)
        images = torch.rand(1, 3, 256, 320)
        boxes, scores = model.detector(images, expected[None])
    found = evaluate.open_model(detector).run(
        None, {"images": images.numpy(), "txt_feats": rows[None]}
    )
    np.testing.assert_allclose(found[0], boxes, atol=1e-2)
    np.testing.assert_allclose(found[1], scores, atol=1e-4)


def test_the_network_is_small_enough():
    assert sum(p.numel() for p in MiniDetector().parameters()) < 2.4e6
