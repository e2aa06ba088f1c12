"""Network over the trunk's features: which marked frontier leads to the target, if any.

A few convolutions make a map of keys and values from an image, for all targets. Each mark, and one
more token for "elsewhere" and the scene, queries it with the target's text. Attention
(arXiv:1706.03762) goes over the map's cells, by their content and their position relative to the
mark, then over the other marks. The network is so small that it stays in float32.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from exporters.training.choice.features import GRID_HW
from exporters.training.mini.net import EMBED_DIM, Conv

NEAR, FAR = 96, 128
"""Channels of the two tensors `features.NECK`."""
_FAR_M, _WIDE_M2 = 8.0, 10.0  # scales of distances and areas in the features
_BIG = 1e4  # subtracted from the logit of a missing mark


class ChoiceNet(nn.Module):
    """Map, text and marks → logits of the directions ("elsewhere" last) and of the scene."""

    def __init__(self, kinds: int, width: int = 64, heads: int = 4, layers: int = 2) -> None:
        super().__init__()
        self.near, self.far = Conv(NEAR, width, 1), Conv(FAR, width, 1)
        self.kinds = Conv(kinds, width, 1)
        self.map = nn.Sequential(Conv(3 * width, width, 1), Conv(width, width))
        self.place = nn.Parameter(0.02 * torch.randn(width, *GRID_HW))
        self.mark = nn.Linear(width + _GEOMETRY, width)
        self.rest = nn.Linear(_REST, width)
        self.text = nn.Sequential(nn.Linear(EMBED_DIM, width), nn.ReLU(), nn.Linear(width, width))
        self.layers = nn.ModuleList(_Layer(width, heads) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.direction = nn.Linear(width, 1)
        self.of_rest = nn.Linear(width, 2)
        self.register_buffer("cells", cell_centres(), persistent=False)
        self.drop, self.fade = nn.Dropout(0.2), nn.Dropout2d(0.2)

    def read(self, near: Tensor, far: Tensor, evidence: Tensor) -> Tensor:
        """Return the maps of images, (v, width, 8, 10).

        Args:
            near: (v, 96, 8, 10), see `features.NECK`.
            far: (v, 128, 8, 10), see `features.NECK`.
            evidence: (v, kinds, 8, 10) scores in [0, 1].
        """
        x = torch.cat([self.near(near), self.far(far), self.kinds(evidence)], 1)
        return self.map(self.fade(x)) + self.place

    def forward(
        self, seen: Tensor, target: Tensor, text: Tensor, marks: Tensor, others: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the logits of directions and scene.

        Args:
            seen: (v, width, 8, 10), the map of v images.
            target: (v, t, 80) scores of t targets in the cells.
            text: (v, t, 64) their embeddings.
            marks: (v, m, MARK_FIELDS), see `MarksCard`.
            others: (v, OTHERS_FIELDS), see `MarksCard`.

        Returns:
            (v, t, m + 1) logits, very low for a missing mark; (v, t) logits of the scene.
        """
        v, t, m = text.shape[0], text.shape[1], marks.shape[1]
        cells = seen.flatten(2).transpose(1, 2)  # (v, 80, width)
        near = tents(marks[..., :2]) @ cells  # (v, m, width)
        tokens = self.mark(torch.cat([self.drop(near), geometry(marks)], -1))
        rest = self.rest(of_others(others))[:, None]
        tokens = torch.cat([tokens, rest], 1)[:, None] + self.text(text)[:, :, None]
        is_mark = torch.cat([marks[..., -1], torch.ones_like(marks[:, :1, -1])], 1)  # (v, m + 1)
        middle = torch.full_like(marks[:, :1, :2], 0.5)
        away = torch.cat([marks[..., :2], middle], 1)[:, :, None] - self.cells  # (v, m + 1, 80, 2)
        for layer in self.layers:
            tokens = layer(tokens, cells, away, target, is_mark)
        tokens = self.norm(tokens)
        of_rest = self.of_rest(tokens[:, :, m])
        logits = torch.cat([self.direction(tokens[:, :, :m])[..., 0], of_rest[..., :1]], -1)
        return logits - _BIG * (1.0 - is_mark[:, None]), of_rest[..., 1].reshape(v, t)


class _Layer(nn.Module):
    """Attention over cells, attention over tokens, and a feed-forward step for each token."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(3))
        self.ask, self.key_value = nn.Linear(width, width), nn.Linear(width, 2 * width)
        self.bias = nn.Sequential(nn.Linear(4, 16), nn.ReLU(), nn.Linear(16, heads))
        self.on_target = nn.Parameter(torch.zeros(heads))
        self.answer = nn.Linear(width + heads, width)
        self.mix, self.mixed = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.step = nn.Sequential(
            nn.Linear(width, 2 * width), nn.ReLU(), nn.Dropout(0.1), nn.Linear(2 * width, width)
        )

    def forward(
        self, x: Tensor, cells: Tensor, away: Tensor, target: Tensor, is_mark: Tensor
    ) -> Tensor:
        v, t, n, width = x.shape
        h, d = self.heads, width // self.heads
        ask = self.ask(self.norms[0](x)).reshape(v, t * n, h, d).transpose(1, 2)
        key, value = self.key_value(cells).chunk(2, -1)
        key, value = (y.reshape(v, -1, h, d).transpose(1, 2) for y in (key, value))
        score = (ask @ key.transpose(2, 3)).reshape(v, h, t, n, -1) * d**-0.5
        offset = torch.cat([away, away.abs()], -1)
        score = score + self.bias(offset).permute(0, 3, 1, 2)[:, :, None]
        score = score + self.on_target.reshape(1, -1, 1, 1, 1) * target[:, None, :, None]
        p = score.softmax(-1)
        found = (p.reshape(v, h, t * n, -1) @ value).transpose(1, 2).reshape(v, t, n, width)
        seen = (p * target[:, None, :, None]).sum(-1).permute(0, 2, 3, 1)  # (v, t, n, heads)
        x = x + self.answer(torch.cat([found, seen], -1))

        q, k, u = self.mix(self.norms[1](x)).chunk(3, -1)
        score = q @ k.transpose(2, 3) * width**-0.5 - _BIG * (1.0 - is_mark[:, None, None])
        x = x + self.mixed(score.softmax(-1) @ u)
        return x + self.step(self.norms[2](x))


_GEOMETRY, _REST = 17, 6  # number of features of a mark, and of the frontiers without a mark


def geometry(marks: Tensor) -> Tensor:
    """Return features of a mark's position, (…, _GEOMETRY)."""
    u, v, bearing, distance, path, gain, is_mark = marks.unbind(-1)
    waves = [wave(k * torch.pi * u) for k in (1, 2) for wave in (torch.sin, torch.cos)]
    offset = [u, v, bearing, bearing.abs(), distance / _FAR_M, torch.log1p(distance), *waves]
    return torch.stack([*offset, (path - distance) / _FAR_M, *_worth(path, gain), is_mark], -1)


def of_others(others: Tensor) -> Tensor:
    """Return features of all frontiers without a mark, (…, _REST)."""
    count, path, gain = others.unbind(-1)
    return torch.stack([torch.log1p(count), *_worth(path, gain)], -1)


def _worth(path: Tensor, gain: Tensor) -> list[Tensor]:
    """Return features of a path's length and gain, and the score of `edge.policies.search`."""
    wide = torch.sqrt(gain.clamp(min=0.0) + 1e-6)
    return [path / _FAR_M, torch.log1p(path), gain / _WIDE_M2, wide, wide / (1.0 + path)]


def cell_centres() -> Tensor:
    """Return (80, 2), u and v as shares of the image, row by row."""
    h, w = GRID_HW
    v, u = torch.meshgrid((torch.arange(h) + 0.5) / h, (torch.arange(w) + 0.5) / w, indexing="ij")
    return torch.stack([u, v], -1).reshape(-1, 2)


def tents(at: Tensor) -> Tensor:
    """Return bilinear weights, (…, 80), at positions (…, 2), which are shares of the image."""
    h, w = GRID_HW
    columns = torch.arange(w, dtype=at.dtype, device=at.device) + 0.5
    rows = torch.arange(h, dtype=at.dtype, device=at.device) + 0.5
    x = (at[..., :1] * w).clamp(0.5, w - 0.5)
    y = (at[..., 1:] * h).clamp(0.5, h - 0.5)
    across = torch.relu(1.0 - (x - columns).abs())
    down = torch.relu(1.0 - (y - rows).abs())
    return (down[..., :, None] * across[..., None, :]).flatten(-2)
