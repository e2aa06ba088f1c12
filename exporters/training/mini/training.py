"""Training loop of the small detector: one learning-rate curve, with images that grow in stages."""

from __future__ import annotations

import ctypes
import logging
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, distributed, nn

from exporters.files import ExportError
from exporters.training import checkpoint as checkpoints
from exporters.training.learning import Learner, LearningPlan
from exporters.training.mini import looks
from exporters.training.mini.batches import Batch, batches, disturb
from exporters.training.mini.loss import Labels, detection_loss
from exporters.training.mini.net import MiniDetector, PhraseEncoder, anchor_points
from exporters.training.mini.views import Frames

log = logging.getLogger(__name__)

FULL_HW = (256, 320)  # height and width of the detector's input [px]
MAX_GRADIENT_NORM = 10.0  # longer gradients are shortened to it
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


@dataclass(frozen=True)
class TrainingPlan(LearningPlan):
    """Length and learning rates of a run.

    Attributes:
        stages: (steps, (height, width) of the images, number of plain phrases), one after another.
            A plain phrase has no colour or size; see `batches.sample_phrases`.
        batch: images in a step.
    """

    stages: tuple[tuple[int, tuple[int, int], int], ...] = (
        (2500, (160, 192), 0),
        (1000, (192, 256), 0),
        (8000, FULL_HW, 12),
    )
    batch: int = 32
    rate: float = 2e-3
    decay: float = 0.03
    warm_up: int = 200
    average: float = 0.9995
    keep_every: int = 250

    @property
    def steps(self) -> list[tuple[tuple[int, int], int]]:
        """((height, width), number of plain phrases) of every step."""
        return [(hw, plain) for steps, hw, plain in self.stages for _ in range(steps)]


class Model(nn.Module):
    """Detector and phrase encoder, trained together."""

    def __init__(self) -> None:
        super().__init__()
        self.detector = MiniDetector()
        counts = (len(looks.CATEGORIES), len(looks.COLORS), len(looks.SIZES))
        self.encoder = PhraseEncoder(*counts)


def train_on_cores(
    frames: Callable[[], Frames], plan: TrainingPlan, checkpoint: Path, cores: int
) -> None:
    """Train with one process per core; the weights are in `checkpoint` afterwards.

    Each process takes its share of every batch, and the gradients are averaged once a step. Threads
    would synchronise after every layer, and wait for the slowest core each time.

    Raises:
        ExportError: a batch cannot be divided by the number of processes.
    """
    check_cores(plan, cores)
    with tempfile.TemporaryDirectory() as folder:
        args = (cores, f"file://{folder}/rendezvous", frames, plan, checkpoint)
        torch.multiprocessing.spawn(_train_rank, args, cores)


def check_cores(plan: TrainingPlan, cores: int) -> None:
    """Raise ExportError unless `cores` processes can share a batch evenly."""
    if cores < 1 or plan.batch % cores:
        raise ExportError(
            f"--cores: got {cores}; give a number that divides the batch size {plan.batch}"
        )


def _train_rank(
    rank: int,
    cores: int,
    rendezvous: str,
    frames: Callable[[], Frames],
    plan: TrainingPlan,
    checkpoint: Path,
) -> None:
    """Train as one of `cores` processes; they find each other by the URL `rendezvous`."""
    logging.basicConfig(
        level=logging.INFO if rank == 0 else logging.WARNING, format="%(asctime)s %(message)s"
    )
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)  # end together with the parent
    torch.set_num_threads(1)
    distributed.init_process_group("gloo", init_method=rendezvous, rank=rank, world_size=cores)
    train(frames(), plan, checkpoint, share=(rank, cores))
    distributed.destroy_process_group()


def train(
    frames: Frames,
    plan: TrainingPlan,
    checkpoint: Path,
    device: str = "cpu",
    share: tuple[int, int] = (0, 1),
) -> Model:
    """Train, or continue from `checkpoint`; return the averaged weights.

    `share` is (index of this process, number of processes); see `train_on_cores`.

    Raises:
        ExportError: `checkpoint` is of another run, or is no checkpoint.
    """
    rank, ranks = share  # index of this process, number of processes
    run = checkpoints.run_identity(plan, len(frames), ranks, device)
    torch.manual_seed(plan.seed)
    model = Model().to(device).to(memory_format=torch.channels_last)
    steps = plan.steps
    # The phrase encoder is mainly tables of words, which have no weight decay.
    learner = Learner(
        model, plan, len(steps), checkpoint, run, tables=model.encoder, betas=(0.9, 0.99)
    )
    share_gradients = partial(_share_gradients, model, ranks) if ranks > 1 else None
    first = logged_step = learner.done
    logged_s = time.monotonic()
    seed = plan.seed * ranks + rank  # each process has its own images and noise
    stream = batches(frames, plan.batch // ranks, steps, seed, first)
    for step, batch in enumerate(stream, first + 1):
        generator = torch.Generator().manual_seed(seed * 1_000_003 + step)
        loss, parts = _loss(model, batch, generator, device)
        learner.step(loss, MAX_GRADIENT_NORM, share_gradients)
        if step % 50 == 0 or step == len(steps):
            pace = (time.monotonic() - logged_s) / (step - logged_step)
            shown = " ".join(f"{name} {float(value):.3f}" for name, value in parts.items())
            log.info("step %d/%d, %.3f s each: losses: %s", step, len(steps), pace, shown)
            logged_s, logged_step = time.monotonic(), step
        if rank == 0 and (step % plan.keep_every == 0 or step == len(steps)):
            learner.keep()
    return learner.averaged


def _share_gradients(model: nn.Module, ranks: int) -> None:
    """Average the gradients over all processes."""
    gradients = [p.grad for p in model.parameters() if p.grad is not None]
    flat = torch.cat([g.reshape(-1) for g in gradients]).div_(ranks)
    distributed.all_reduce(flat)
    for gradient, part in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(part.view(gradient.shape))


def _loss(
    model: Model, batch: Batch, generator: torch.Generator, device: str
) -> tuple[Tensor, dict[str, Tensor]]:
    """Return the loss of a batch and its parts by name; the images get noise from `generator`."""
    images = disturb(batch.images.to(device), generator)
    images = images.contiguous(memory_format=torch.channels_last)
    labels = Labels(
        batch.labels.boxes.to(device), batch.labels.taught.to(device),
        batch.labels.answers.to(device), batch.labels.hard.to(device),
    )  # fmt: skip
    with torch.autocast(device.partition(":")[0], torch.bfloat16):
        box, embeddings = model.detector.features(images)
    text = model.encoder(batch.phrases.to(device))
    box, logits = box.float(), model.detector.logits(embeddings.float(), text)
    anchors, stride = anchor_points(images.shape[2], images.shape[3], device)
    decoded = model.detector.decode(box, anchors, stride)
    return detection_loss(box, decoded, logits, anchors, stride, labels)
