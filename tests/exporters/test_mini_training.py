"""The small detector learns, and its ONNX files say what the network says."""

from __future__ import annotations

import shutil
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import yaml

pytestmark = pytest.mark.export
torch = pytest.importorskip("torch", reason="torch is not installed (extra `export`)")
pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

from edge.perception.onnx_file import read_onnx  # noqa: E402
from exporters import train_mini  # noqa: E402
from exporters.files import ExportError, sha256_of  # noqa: E402
from exporters.mini import batches, checkpoint, evaluate, export, loss, training, views  # noqa: E402
from exporters.mini.net import STRIDES, MiniDetector, anchor_points  # noqa: E402
from exporters.mini.views import Frames, make_frames  # noqa: E402
from exporters.onnx_format import cpu_session  # noqa: E402

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


def truth(boxes, answers=1) -> loss.Labels:
    boxes = torch.tensor(boxes, dtype=torch.float32)[None]
    said = torch.full((1, boxes.shape[1], 1), answers, dtype=torch.int8)
    taught = torch.ones(boxes.shape[:2], dtype=torch.bool)
    return loss.Labels(boxes, taught, said, torch.zeros_like(said, dtype=torch.bool))


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
    first_s = checkpoint.load(tmp_path / "parts.pt")["seconds"]
    again = training.train(frames, plan(10), tmp_path / "parts.pt")
    kept = checkpoint.load(tmp_path / "parts.pt")
    assert kept["step"] == 10
    assert kept["seconds"] > first_s > 0
    for a, b in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b)


def test_two_processes_train_one_model(frames, tmp_path, monkeypatch):
    """The model is that of one process which is handed the other's gradients."""
    torch.set_num_threads(1)
    others = []
    monkeypatch.setattr(training.distributed, "all_reduce", lambda g: others.append(g.clone()))
    training.train(frames, plan(1), tmp_path / "other.pt", share=(1, 2))
    assert len(others) == 1, "a step shares its gradients once"
    monkeypatch.setattr(training.distributed, "all_reduce", lambda g: g.add_(others[0]))
    one = training.train(frames, plan(1), tmp_path / "one.pt", share=(0, 2))
    make = partial(Frames, np.array(frames.rgb), frames.objects, frames.start)
    training.train_on_cores(make, plan(1), tmp_path / "two.pt", 2)
    two, kept = export.load_model(tmp_path / "two.pt")
    assert (kept["step"], kept["ranks"]) == (1, 2)
    for a, b in zip(one.state_dict().values(), two.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b)


def test_the_shared_gradient_is_the_mean(monkeypatch):
    """Of two processes with the same gradients: theirs, not the sum."""
    model = torch.nn.Linear(3, 2)
    for parameter in model.parameters():
        parameter.grad = torch.full_like(parameter, 0.5)
    monkeypatch.setattr(training.distributed, "all_reduce", lambda gradient: gradient.mul_(2))
    training._share_gradients(model, 2)
    assert all((parameter.grad == 0.5).all() for parameter in model.parameters())


@pytest.fixture(scope="module")
def run_of(frames, tmp_path_factory):
    """A checkpoint of two steps, and which run it is of."""
    path = tmp_path_factory.mktemp("run") / "checkpoint.pt"
    training.train(frames, plan(2), path)
    return path, checkpoint.describe(plan(2), len(frames), 1, "cpu")


def test_a_checkpoint_says_which_run_it_is_of(run_of):
    path, run = run_of
    kept = checkpoint.load(path)
    assert {key: kept[key] for key in run} == run
    assert kept["torch"] == torch.__version__
    assert checkpoint.resume(path, run)["step"] == 2
    assert checkpoint.resume(path.with_name("none.pt"), run) is None


@pytest.mark.parametrize(
    ("plan_change", "change", "says"),
    [
        ({"seed": 1}, {}, "seed was 0 and is 1"),
        ({"batch": 8}, {}, "batch was 4 and is 8"),
        ({"stages": ((3, HW, 2),)}, {}, "stages was "),
        ({}, {"ranks": 2}, "ranks was 1 and is 2"),
        ({}, {"frames": 9}, "frames was 8 and is 9"),
        ({}, {"device": "cuda"}, "device was cpu and is cuda"),
    ],
)
def test_a_run_does_not_go_on_as_another(run_of, plan_change, change, says):
    path, run = run_of
    other = {**run, **change, "plan": {**run["plan"], **plan_change}}
    with pytest.raises(ExportError, match=rf"{says}.*use another --out"):
        checkpoint.resume(path, other)


def test_training_refuses_the_checkpoint_of_another_run(run_of, frames):
    with pytest.raises(ExportError, match="seed was 0 and is 7"):
        training.train(frames, plan(2, seed=7), run_of[0])


@pytest.mark.parametrize(
    ("kept", "says"),
    [
        ({"model": {}, "averaged": {}, "step": 5, "seed": 0}, "of an older version .has no plan"),
        (None, "cannot be read as a checkpoint"),
    ],
)
def test_what_is_no_checkpoint_is_refused_in_one_line(tmp_path, kept, says):
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(b"PK") if kept is None else torch.save(kept, path)
    with pytest.raises(ExportError, match=says) as caught:
        checkpoint.load(path)
    assert "use another --out" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--houses", "0"], "--houses 0: give at least 1"),
        (["--cores", "0"], "--cores 0: give at least 1"),
        (["--cores", "3"], "--cores 3: give a number that divides the batch of 32"),
        (["--houses", "1", "--seed", "4"], "use another --out"),
    ],
)
def test_what_cannot_be_trained_is_one_line_before_anything_is_rendered(
    run_of, capsys, monkeypatch, options, says
):
    monkeypatch.setattr(views, "make_frames", None)
    out = str(run_of[0].parent)
    assert train_mini.main(["--out", out, "--device", "cpu", *options]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert says in error
    assert error.count("\n") == 1


@pytest.fixture
def trained(run_of, tmp_path, monkeypatch):
    """A folder of a run whose export takes no time; its model sees as `figures` say."""
    figures = {"map50": 0.75, "pairs": (9, 10)}

    def write(module, path):
        path.write_bytes(path.name.encode())

    def measure(*args):
        if figures["map50"] is None:
            raise ExportError("cannot be measured")
        pairs = {"color": figures["pairs"], "size": (0, 0), "cut_off_size": (0, 0)}
        return evaluate.Report(
            {"chair": figures["map50"]}, {"chair": 1}, pairs, np.ones((1, 2)), (1.0, 1.0)
        )

    run = tmp_path / "run"
    run.mkdir()
    shutil.copy(run_of[0], run)
    monkeypatch.setattr(export, "export_detector", write)
    monkeypatch.setattr(export, "export_encoder", write)
    monkeypatch.setattr(export, "quantize", lambda fp32, out, *args: write(None, out))
    monkeypatch.setattr(export, "calibration_feeds", lambda *args: [])
    monkeypatch.setattr(export, "make_frames", lambda *args: None)
    monkeypatch.setattr(evaluate, "held_out_frames", lambda folder: None)
    monkeypatch.setattr(evaluate, "measure", measure)
    return run, figures


def export_to(out, run, *options) -> int:
    return export.main([str(run), "--out", str(out), *options])


def shipped(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def out(tmp_path):
    """A folder with a model that is shipped already."""
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / f"{export.DETECTOR}.onnx").write_bytes(b"shipped")
    return folder


@pytest.mark.parametrize(
    ("map50", "pairs", "says"),
    [
        (None, (9, 10), "cannot be measured"),
        (0.5, (9, 10), "ap50 0.5 < 0.7"),
        (0.75, (7, 10), "pairs_told_apart 0.7 < 0.8"),
    ],
)
def test_a_model_that_does_not_pass_leaves_the_shipped_one(
    trained, out, capsys, map50, pairs, says
):
    run, figures = trained
    figures |= {"map50": map50, "pairs": pairs}
    before = shipped(out)
    assert export_to(out, run) == 1
    assert says in capsys.readouterr().err
    assert shipped(out) == before
    if map50 is not None:
        assert export_to(out, run, "--no-gate") == 0
        assert shipped(out) != before


def test_a_model_is_put_in_place_at_the_end_files_before_cards(trained, out, monkeypatch):
    replace, order = Path.replace, []

    def record(self, target):
        order.append(Path(target))
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", record)
    assert export_to(out, trained[0]) == 0
    names = [f"{export.TEXT}.onnx", f"{export.DETECTOR}.onnx"]
    names += [f"{name}.yaml" for name in (export.DETECTOR, export.TEXT, export.SIMILARITY)]
    assert [path.name for path in order] == names
    assert sorted(shipped(out)) == sorted(names)


def test_what_cannot_be_written_whole_is_not_put_in_place_at_all(trained, out, monkeypatch):
    """The disk is full after three of the five."""
    run, before, write, written = trained[0], shipped(out), Path.write_bytes, []

    def write_some(self, content):
        written.append(self)
        if len(written) > 3:
            raise OSError("No space left on device")
        return write(self, content)

    for name in (export.TEXT, export.DETECTOR):
        (run / f"{name}.onnx").write_bytes(b"new")
    monkeypatch.setattr(Path, "write_bytes", write_some)
    with pytest.raises(OSError, match="No space"):
        export.publish(run, out, {})
    assert shipped(out) == before


def test_the_cards_say_what_was_trained_and_measured(trained, out):
    assert export_to(out, trained[0]) == 0
    card = yaml.safe_load((out / f"{export.DETECTOR}.yaml").read_text())
    assert card["sha256"] == sha256_of(out / card["file"])
    training_block, held_out = (card["measured"][k] for k in ("training", "held-out houses"))
    assert training_block["frames"] == 8
    assert training_block["steps"] == 2
    assert training_block["processes"] == 1
    assert (held_out["ap50"], held_out["color_questions"]) == (0.75, 10)
    assert held_out["bytes"] == (out / card["file"]).stat().st_size


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, ""),
        ({"plan": {"seed": 3}}, " --seed 3"),
        ({"frames": 110}, " --houses 10"),
        ({"ranks": 4}, " --cores 4"),
        ({"ranks": 1, "device": "cuda"}, ""),
    ],
)
def test_the_card_gives_the_command_that_trains_the_same(change, said):
    kept = {"plan": {"seed": 0}, "frames": 33_000, "ranks": 2, "device": "cpu", "step": 11_500}
    kept |= {"seconds": 5430.0, "torch": "2.13.0", "machine": "x86_64"} | change
    figures = export.training_figures(kept)
    assert figures["command"] == (
        f"python -m exporters.train_mini --out RUN{said} && python -m exporters.mini.export RUN"
    )
    assert figures["houses"] == kept["frames"] // 11
    assert (figures["minutes"], figures["steps"]) == (90, 11_500)


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
    rows = cpu_session(text).run(None, {"tokens": tokens})[0]
    with torch.no_grad():
        expected = model.encoder(torch.from_numpy(tokens))
        np.testing.assert_allclose(rows, expected, atol=1e-5)
        images = torch.rand(1, 3, 256, 320)
        boxes, scores = model.detector(images, expected[None])
    found = cpu_session(detector).run(None, {"images": images.numpy(), "txt_feats": rows[None]})
    np.testing.assert_allclose(found[0], boxes, atol=1e-2)
    np.testing.assert_allclose(found[1], scores, atol=1e-4)


def test_the_network_is_small_enough():
    assert sum(p.numel() for p in MiniDetector().parameters()) < 2.4e6
