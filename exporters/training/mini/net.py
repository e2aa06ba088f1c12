"""Network of the small detector, and the network that encodes phrases as its text features.

Shapes: b images, h x w cells, a anchors (the cells of all heads), n phrases.

A small YOLO: a CSP trunk, a PAN neck, and a head for each stride. A head has a box (distribution
focal loss, arXiv:2006.04388) and an embedding that is compared with the text, as in YOLO-World
(arXiv:2401.17270, section 3.2; without its text-guided fusion). Convolutions end in a ReLU, so that
the INT8 model runs in integer kernels throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

EMBED_DIM = 64
"""Length of text features and embeddings."""
STRIDES = (8, 16, 32)
"""Size of a cell of each of the three heads [px]."""
BINS = 8
"""Bins of a box edge's distribution; an edge is at most BINS - 1 strides from its anchor."""


@dataclass(frozen=True, slots=True)
class Widths:
    """Size of the network: channels, and residual blocks.

    Attributes:
        trunk: channels of the trunk's stages.
        blocks: residual blocks of the trunk's stages after the first.
        neck: channels of the neck's levels.
        text_head: channels inside a head, for the embedding.
    """

    trunk: tuple[int, int, int, int, int] = (16, 32, 64, 128, 256)
    blocks: tuple[int, int, int, int] = (1, 2, 2, 1)
    neck: tuple[int, int, int] = (64, 96, 128)
    box_head: int = 48
    text_head: int = 64


class Conv(nn.Sequential):
    """Convolution, batch normalization and ReLU."""

    def __init__(self, c_in: int, c_out: int, k: int = 3, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(c_in, c_out, k, stride, k // 2, bias=False),
            nn.BatchNorm2d(c_out, eps=1e-3, momentum=0.03),
            nn.ReLU(inplace=True),
        )


class Residual(nn.Module):
    """Two convolutions of `c` channels; with `add`, the input is added to their output."""

    def __init__(self, c: int, add: bool) -> None:
        super().__init__()
        self.a, self.b, self.add = Conv(c, c), Conv(c, c), add

    def forward(self, x: Tensor) -> Tensor:
        y = self.b(self.a(x))
        return x + y if self.add else y


class CSP(nn.Module):
    """Cross-stage block (YOLOv8's C2f).

    Half of the channels pass through the residual blocks. The output is computed from the inputs
    and outputs of all blocks.
    """

    def __init__(self, c_in: int, c_out: int, n: int, add: bool) -> None:
        super().__init__()
        half = c_out // 2
        self.left, self.right = Conv(c_in, half, 1), Conv(c_in, half, 1)
        self.blocks = nn.ModuleList(Residual(half, add) for _ in range(n))
        self.out = Conv((2 + n) * half, c_out, 1)

    def forward(self, x: Tensor) -> Tensor:
        kept = [self.left(x), self.right(x)]
        for block in self.blocks:
            kept.append(block(kept[-1]))
        return self.out(torch.cat(kept, 1))


class SPPF(nn.Module):
    """Spatial pyramid pooling: three max pools in a row, and their outputs side by side."""

    def __init__(self, c: int) -> None:
        super().__init__()
        self.squeeze, self.out = Conv(c, c // 2, 1), Conv(2 * c, c, 1)
        self.pool = nn.MaxPool2d(5, 1, 2)

    def forward(self, x: Tensor) -> Tensor:
        kept = [self.squeeze(x)]
        for _ in range(3):
            kept.append(self.pool(kept[-1]))
        return self.out(torch.cat(kept, 1))


class Trunk(nn.Module):
    """Image (b, 3, h, w) in 0..1 → features at strides 8, 16, 32."""

    def __init__(self, w: Widths) -> None:
        super().__init__()
        t, n = w.trunk, w.blocks
        # A name has its stride: s8 is the output with cells of 8 px.
        self.stem = Conv(3, t[0], 3, 2)
        self.s4 = nn.Sequential(Conv(t[0], t[1], 3, 2), CSP(t[1], t[1], n[0], True))
        self.s8 = nn.Sequential(Conv(t[1], t[2], 3, 2), CSP(t[2], t[2], n[1], True))
        self.s16 = nn.Sequential(Conv(t[2], t[3], 3, 2), CSP(t[3], t[3], n[2], True))
        self.s32 = nn.Sequential(Conv(t[3], t[4], 3, 2), CSP(t[4], t[4], n[3], True), SPPF(t[4]))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        s8 = self.s8(self.s4(self.stem(x)))
        s16 = self.s16(s8)
        return s8, s16, self.s32(s16)


class Neck(nn.Module):
    """Features mixed over scales, downwards and upwards (PAN)."""

    def __init__(self, w: Widths) -> None:
        super().__init__()
        # Channels by stride: of the trunk's output (c), and of the neck's (n).
        (_, _, c8, c16, c32), (n8, n16, n32) = w.trunk, w.neck
        self.up = nn.Upsample(scale_factor=2, mode="nearest")
        self.top16, self.top8 = CSP(c16 + c32, n16, 1, False), CSP(c8 + n16, n8, 1, False)
        self.down16, self.low16 = Conv(n8, n8, 3, 2), CSP(n8 + n16, n16, 1, False)
        self.down32, self.low32 = Conv(n16, n16, 3, 2), CSP(n16 + c32, n32, 1, False)

    def forward(self, s8: Tensor, s16: Tensor, s32: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        mid = self.top16(torch.cat([self.up(s32), s16], 1))
        out8 = self.top8(torch.cat([self.up(mid), s8], 1))
        out16 = self.low16(torch.cat([self.down16(out8), mid], 1))
        out32 = self.low32(torch.cat([self.down32(out16), s32], 1))
        return out8, out16, out32


class Head(nn.Module):
    """Box distributions (b, 4 BINS, h, w) and embeddings (b, EMBED_DIM, h, w) of one stride."""

    def __init__(self, c: int, w: Widths) -> None:
        super().__init__()
        self.box = nn.Sequential(
            Conv(c, w.box_head), Conv(w.box_head, w.box_head),
            nn.Conv2d(w.box_head, 4 * BINS, 1),
        )  # fmt: skip
        self.text = nn.Sequential(
            Conv(c, w.text_head), Conv(w.text_head, w.text_head),
            nn.Conv2d(w.text_head, EMBED_DIM, 1, bias=False),
            nn.BatchNorm2d(EMBED_DIM, eps=1e-3, momentum=0.03),
        )  # fmt: skip

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        return self.box(x), self.text(x)


class MiniDetector(nn.Module):
    """The detector: images (b, 3, h, w) in 0..1 and text features (b, n, EMBED_DIM) in.

    It returns boxes (b, a, 4) in input pixels and scores (b, a, n).
    """

    def __init__(self, widths: Widths | None = None) -> None:
        super().__init__()
        w = widths or Widths()
        self.trunk, self.neck = Trunk(w), Neck(w)
        self.heads = nn.ModuleList(Head(c, w) for c in w.neck)
        self.scale = nn.Parameter(torch.tensor(1.0))
        self.bias = nn.Parameter(torch.tensor(-6.0))
        self.register_buffer("bins", torch.arange(BINS, dtype=torch.float32), persistent=False)

    def features(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return box distributions (b, a, 4, BINS) as logits, and embeddings (b, a, EMBED_DIM)."""
        levels = self.neck(*self.trunk(images))
        boxes, embeddings = [], []
        for head, level in zip(self.heads, levels, strict=True):
            box, embedding = head(level)
            boxes.append(box.flatten(2))
            embeddings.append(embedding.flatten(2))
        box = torch.cat(boxes, 2)
        n = box.shape[2]
        return (
            box.reshape(-1, 4, BINS, n).permute(0, 3, 1, 2),
            torch.cat(embeddings, 2).transpose(1, 2),
        )

    def logits(self, embeddings: Tensor, text: Tensor) -> Tensor:
        """Return scores before the sigmoid, (b, a, n)."""
        return embeddings @ (text * self.scale.exp()).transpose(1, 2) + self.bias

    def decode(self, box: Tensor, anchors: Tensor, stride: Tensor) -> Tensor:
        """Return boxes x0 y0 x1 y1 in input pixels, (b, a, 4): the means of the distributions.

        A distribution is over an edge's distance from the anchor, in strides.
        """
        # Distances of the left, upper, right and lower edge.
        edges = box.softmax(-1) @ self.bins
        low = anchors - edges[..., :2] * stride
        return torch.cat([low, anchors + edges[..., 2:] * stride], -1)

    def forward(self, images: Tensor, text: Tensor) -> tuple[Tensor, Tensor]:
        box, embeddings = self.features(images)
        anchors, stride = anchor_points(images.shape[2], images.shape[3], images.device)
        return self.decode(box, anchors, stride), self.logits(embeddings, text).sigmoid()


def anchor_points(height: int, width: int, device=None) -> tuple[Tensor, Tensor]:
    """Return cell centres (a, 2) in input pixels and their strides (a, 1), stride after stride."""
    points, strides = [], []
    for s in STRIDES:
        y, x = torch.meshgrid(
            torch.arange(height // s, device=device), torch.arange(width // s, device=device),
            indexing="ij",
        )  # fmt: skip
        points.append((torch.stack([x, y], -1).reshape(-1, 2) + 0.5) * s)
        strides.append(torch.full((len(points[-1]), 1), float(s), device=device))
    return torch.cat(points), torch.cat(strides)


class PhraseEncoder(nn.Module):
    """Encoder of phrases, (…, 3) int64 as in `looks`, to unit vectors (…, EMBED_DIM)."""

    def __init__(self, categories: int, colors: int, sizes: int, width: int = 128) -> None:
        super().__init__()
        counts = (categories, colors, sizes)
        self.tables = nn.ModuleList(nn.Embedding(1 + n, width) for n in counts)
        for table in self.tables:
            nn.init.normal_(table.weight, std=0.5)
        self.mix = nn.Sequential(
            nn.Linear(width, width), nn.ReLU(inplace=True), nn.Linear(width, EMBED_DIM)
        )

    def forward(self, tokens: Tensor) -> Tensor:
        x = sum(table(tokens[..., k]) for k, table in enumerate(self.tables))
        return nn.functional.normalize(self.mix(x), dim=-1)
