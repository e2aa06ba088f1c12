"""The small detector learns, its ONNX files match the network, and only good ones ship."""

from __future__ import annotations

from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import yaml

pytestmark = pytest.mark.export
torch = pytest.importorskip("torch", reason="torch is not installed (extra `export`)")
pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

from edge.perception.runtime.onnx_file import read_onnx  # noqa: E402
from exporters.files import ExportError, sha256_of  # noqa: E402
from exporters.onnx_format import cpu_session  # noqa: E402
from exporters.training import checkpoint  # noqa: E402
from exporters.training.mini import batches, evaluate, export, loss, training, views  # noqa: E402
from exporters.training.mini.__main__ import main  # noqa: E402
from exporters.training.mini.net import anchor_points  # noqa: E402
from exporters.training.mini.views import Frames, make_frames  # noqa: E402

HW = (64, 96)
POINTS, STRIDE = anchor_points(*HW)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    torch.set_num_threads(1)  # threads that meet at every layer are slow on a busy machine
    return make_frames(range(4), 2, tmp_path_factory.mktemp("data"))


def plan(steps: int, **changes) -> training.TrainingPlan:
    return training.TrainingPlan(
        stages=((steps, HW, 2),), batch=4, warm_up=5, keep_every=5, **changes
    )


def truth(boxes, answers=1, taught=True) -> loss.Labels:
    boxes = torch.tensor(boxes, dtype=torch.float32)[None]
    said = torch.full((1, boxes.shape[1], 1), answers, dtype=torch.int8)
    shown = torch.full(boxes.shape[:2], taught)
    return loss.Labels(boxes, shown, said, torch.zeros_like(said, dtype=torch.bool))


def test_an_empty_picture_has_no_owner_and_a_finite_loss():
    nothing = truth(np.zeros((1, 4)), 0, taught=False)
    box = torch.zeros(1, len(POINTS), 4, 8, requires_grad=True)
    decoded = torch.cat([POINTS - STRIDE, POINTS + STRIDE], -1)[None] + box.sum() * 0
    logits = torch.full((1, len(POINTS), 1), -6.0, requires_grad=True)
    owner, quality = loss.assign(logits.sigmoid(), decoded, POINTS, nothing)
    assert (owner == -1).all()
    assert (quality == 0).all()
    total, _ = loss.detection_loss(box, decoded, logits, POINTS, STRIDE, nothing)
    total.backward()
    assert torch.isfinite(total)


def test_anchors_inside_a_box_are_assigned_to_it():
    there = truth([[20.0, 20.0, 60.0, 70.0]])
    decoded = torch.cat([POINTS - 2 * STRIDE, POINTS + 2 * STRIDE], -1)[None]
    owner, quality = loss.assign(torch.full((1, len(POINTS), 1), 0.1), decoded, POINTS, there)
    mine = POINTS[owner[0] == 0]
    assert 0 < len(mine) <= loss.TOP_K
    assert (mine[:, 0] > 20).all()
    assert (mine[:, 0] < 60).all()
    assert 0 < quality.max() <= 1


def test_an_unsure_answer_adds_no_loss():
    unsure = truth([[20.0, 20.0, 60.0, 70.0]], -1)
    decoded = torch.cat([POINTS - 2 * STRIDE, POINTS + 2 * STRIDE], -1)[None]
    logits = torch.zeros(1, len(POINTS), 1, requires_grad=True)
    box = torch.zeros(1, len(POINTS), 4, 8)
    _, parts = loss.detection_loss(box, decoded, logits, POINTS, STRIDE, unsure)
    inside = ((torch.tensor([20, 20]) < POINTS) & (torch.tensor([60, 70]) > POINTS)).all(-1)
    assert parts["classes"] == pytest.approx(float((~inside).sum()) * np.log(2), rel=1e-4)


def test_a_cut_keeps_boxes_on_their_pixels():
    rng = np.random.default_rng(1)
    rgb = np.zeros((256, 320, 3), np.uint8)
    rgb[80:160, 100:220] = 255
    boxes = np.array([[100.0, 80.0, 220.0, 160.0]], np.float32)
    for _ in range(20):
        picture, moved, share = batches.cut(rgb, boxes, HW, rng)
        ys, xs = np.nonzero((picture == 255).all(axis=2))
        if share[0] >= 0.2:
            found = [xs.min(), ys.min(), xs.max() + 1, ys.max() + 1]
            np.testing.assert_allclose(moved[0], found, atol=1.6)


def test_a_few_steps_lower_the_loss(frames, tmp_path):
    stream = list(batches.batches(frames, 4, [(HW, 2)], seed=0))
    model = training.train(frames, plan(25), tmp_path / "a.pt")
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        first, last = (
            training._loss(of.train(), stream[0], generator, "cpu")[0]
            for of in (training.Model(), model)
        )
    assert last < 0.7 * first


def test_training_resumes_from_its_checkpoint(frames, tmp_path, monkeypatch):
    whole = training.train(frames, plan(10), tmp_path / "whole.pt")
    stream = training.batches
    with monkeypatch.context() as cut_off:
        cut_off.setattr(training, "batches", lambda *a: islice(stream(*a), 5))
        training.train(frames, plan(10), tmp_path / "parts.pt")
    first = checkpoint.load(tmp_path / "parts.pt")
    again = training.train(frames, plan(10), tmp_path / "parts.pt")
    kept = checkpoint.load(tmp_path / "parts.pt")
    assert (first["step"], kept["step"]) == (5, 10)
    assert kept["seconds"] > first["seconds"] > 0
    for a, b in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b)


def test_two_processes_train_one_model(frames, tmp_path, monkeypatch):
    """The model is that of one process which is handed the other's gradients."""
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


@pytest.fixture(scope="module")
def run_of(frames, tmp_path_factory):
    """Return a checkpoint of two steps and its run's id."""
    path = tmp_path_factory.mktemp("run") / "checkpoint.pt"
    training.train(frames, plan(2), path)
    return path, checkpoint.run_identity(plan(2), len(frames), 1, "cpu")


@pytest.mark.parametrize(
    ("plan_change", "change", "says"),
    [
        ({}, {}, None),
        ({"seed": 1}, {}, "seed is 0 there and 1 now"),
        ({"stages": ((3, HW, 2),)}, {}, "stages is "),
        ({}, {"ranks": 2}, "ranks is 1 there and 2 now"),
        ({}, {"frames": 9}, "frames is 8 there and 9 now"),
        ({}, {"device": "cuda"}, "device is cpu there and cuda now"),
    ],
)
def test_a_run_with_other_settings_is_not_resumed(run_of, plan_change, change, says):
    path, run = run_of
    other = {**run, **change, "plan": {**run["plan"], **plan_change}}
    assert checkpoint.resume(path.with_name("none.pt"), other) is None
    if says is None:
        assert checkpoint.resume(path, other)["torch"] == torch.__version__
        return
    with pytest.raises(ExportError, match=rf"{says}.*use another --out"):
        checkpoint.resume(path, other)


@pytest.mark.parametrize(
    ("kept", "says"),
    [
        ({"model": {}, "averaged": {}, "step": 5, "seed": 0}, "of an older version .without plan"),
        (None, "not a readable checkpoint"),
    ],
)
def test_an_invalid_checkpoint_is_refused_in_one_line(tmp_path, kept, says):
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(b"PK") if kept is None else torch.save(kept, path)
    with pytest.raises(ExportError, match=says) as caught:
        checkpoint.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--cores", "3"], "--cores: got 3; give a number that divides the batch size 32"),
        (["--houses", "1", "--seed", "4"], "use another --out"),
    ],
)
def test_invalid_options_are_refused_before_rendering(run_of, capsys, monkeypatch, options, says):
    monkeypatch.setattr(views, "make_frames", None)
    assert main(["--out", str(run_of[0].parent), "--device", "cpu", *options]) == 1
    (error,) = capsys.readouterr().err.splitlines()
    assert error.startswith("error: ")
    assert says in error


@pytest.mark.parametrize("option", ["--houses", "--cores"])
def test_a_count_below_one_is_refused(tmp_path, capsys, option):
    with pytest.raises(SystemExit):
        main(["--out", str(tmp_path), option, "0"])
    assert f"{option}: expected an integer from 1, got 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], ""),
        (["--seed", "3", "--cores", "4"], " --seed 3 --cores 4"),
        (["--device", "cuda", "--houses", "10"], " --houses 10"),
    ],
)
def test_the_card_gives_the_command_that_trains_the_same(
    frames, tmp_path, monkeypatch, options, said
):
    put = []
    monkeypatch.setattr(views, "make_frames", lambda *args: frames)
    monkeypatch.setattr(training, "train_on_cores", lambda *args: None)
    monkeypatch.setattr(training, "train", lambda *args: None)
    monkeypatch.setattr(export, "put_in_place", lambda *args, gate: put.append((*args, gate)))
    words = ["--out", str(tmp_path), "--models", str(tmp_path / "m"), "--device", "cpu", *options]
    assert main(words) == 0
    command = f"python -m exporters.training.mini --out RUN{said}"
    assert put == [(tmp_path, tmp_path / "m", command, True)]


@pytest.fixture
def trained(run_of, tmp_path, monkeypatch):
    """Return a run's folder with a fast export; the model's scores are `figures`."""
    figures = {"map50": 0.75, "pairs": (9, 10)}

    def write(_, path, *args):
        path.write_bytes(b"made")

    def measure(*args):
        if figures["map50"] is None:
            raise ExportError("cannot be measured")
        pairs = {"color": figures["pairs"], "size": (0, 0), "cut_off_size": (0, 0)}
        ap = {"chair": figures["map50"]}
        return evaluate.Report(ap, {"chair": 1}, pairs, np.ones((1, 2)), (1.0, 1.0))

    run = tmp_path / "run"
    run.mkdir()
    (run / "checkpoint.pt").write_bytes(run_of[0].read_bytes())
    for name in ("export_detector", "export_encoder", "quantize"):
        monkeypatch.setattr(export, name, write)
    for module, name in ((export, "calibration_feeds"), (export, "make_frames"),
                         (evaluate, "held_out_frames")):  # fmt: skip
        monkeypatch.setattr(module, name, lambda *args: None)
    monkeypatch.setattr(evaluate, "measure", measure)
    return run, figures


def shipped(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def out(tmp_path):
    """Return a folder that already contains a shipped model."""
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / f"{export.DETECTOR}.onnx").write_bytes(b"shipped")
    return folder


@pytest.mark.parametrize(
    ("map50", "pairs", "says"),
    [
        (None, (9, 10), "cannot be measured"),
        (0.5, (9, 10), r"ap50 0\.5 < 0\.7"),
        (0.75, (7, 10), r"pairs_told_apart 0\.7 < 0\.8"),
    ],
)
def test_a_model_that_does_not_pass_leaves_the_shipped_one(trained, out, map50, pairs, says):
    run, figures = trained
    figures |= {"map50": map50, "pairs": pairs}
    before = shipped(out)
    with pytest.raises(ExportError, match=says):
        export.put_in_place(run, out, "make", gate=True)
    assert shipped(out) == before
    if map50 is not None:
        export.put_in_place(run, out, "make", gate=False)
        assert shipped(out) != before


def test_model_files_are_replaced_before_their_cards(trained, out, monkeypatch):
    replace, order = Path.replace, []

    def record(self, target):
        order.append(Path(target).name)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", record)
    export.put_in_place(trained[0], out, "make", gate=True)
    names = [f"{export.TEXT}.onnx", f"{export.DETECTOR}.onnx"]
    names += [f"{name}.yaml" for name in (export.DETECTOR, export.TEXT, export.SIMILARITY)]
    assert order == names
    card = yaml.safe_load((out / f"{export.DETECTOR}.yaml").read_text())
    assert card["sha256"] == sha256_of(out / card["file"])
    trained_as, held_out = (card["measured"][k] for k in ("training", "held-out houses"))
    assert [trained_as[k] for k in ("command", "frames", "steps", "processes")] == ["make", 8, 2, 1]
    assert (held_out["ap50"], held_out["color_questions"]) == (0.75, 10)
    assert held_out["bytes"] == (out / card["file"]).stat().st_size


def test_a_failed_write_leaves_the_shipped_files_unchanged(trained, out, monkeypatch):
    """The disk is full after three of the five."""
    before, write, written = shipped(out), Path.write_bytes, []

    def write_some(self, content):
        written.extend([self] * (self.parent == out))
        if len(written) > 3:
            raise OSError("No space left on device")
        return write(self, content)

    monkeypatch.setattr(Path, "write_bytes", write_some)
    with pytest.raises(OSError, match="No space"):
        export.put_in_place(trained[0], out, "make", gate=True)
    assert shipped(out) == before


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
