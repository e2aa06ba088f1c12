"""Network of the choice model: rates the marked frontiers of an image for a target.

It reads the features of the detector's trunk. A few convolutions make a feature map (8 x 10 cells)
of an image, for all targets. There is a token, a vector of `width` values, for each mark, and one
more for "elsewhere" and the scene. A target's text is added to the tokens. Attention
(arXiv:1706.03762) goes over the map's cells, by their content and their position relative to the
mark, then over the other tokens. The network is so small that it stays in float32.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from exporters.training.choice.features import GRID_HW
from exporters.training.mini.net import EMBED_DIM, Conv

NECK16_CHANNELS, NECK32_CHANNELS = 96, 128
"""Channels of the two tensors `features.NECK`."""
_FAR_M, _WIDE_M2 = 8.0, 10.0  # by these, distances and areas are divided
_BIG = 1e4  # subtracted from the logit of a missing mark
# Numbers of features of a mark, and of the frontiers without a mark.
_MARK_FEATURES, _OTHERS_FEATURES = 17, 6


class ChoiceNet(nn.Module):
    """The network: map, text and marks → logits of directions ("elsewhere" last) and scene."""

    def __init__(self, kinds: int, width: int = 64, heads: int = 4, layers: int = 2) -> None:
        super().__init__()
        # The names are in checkpoints: `near` reads `neck16`, `far` reads `neck32`.
        self.near, self.far = Conv(NECK16_CHANNELS, width, 1), Conv(NECK32_CHANNELS, width, 1)
        self.kinds = Conv(kinds, width, 1)
        self.map = nn.Sequential(Conv(3 * width, width, 1), Conv(width, width))
        self.place = nn.Parameter(0.02 * torch.randn(width, *GRID_HW))  # position of each cell
        self.mark = nn.Linear(width + _MARK_FEATURES, width)
        self.rest = nn.Linear(_OTHERS_FEATURES, width)  # frontiers without a mark
        self.text = nn.Sequential(nn.Linear(EMBED_DIM, width), nn.ReLU(), nn.Linear(width, width))
        self.layers = nn.ModuleList(_Layer(width, heads) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.direction = nn.Linear(width, 1)  # logit of a mark
        self.of_rest = nn.Linear(width, 2)  # logits of "elsewhere" and of the scene
        self.register_buffer("cells", cell_centres(), persistent=False)
        self.drop, self.fade = nn.Dropout(0.2), nn.Dropout2d(0.2)

    def read(self, neck16: Tensor, neck32: Tensor, evidence: Tensor) -> Tensor:
        """Return the maps of images, (v, width, 8, 10).

        Args:
            neck16: (v, 96, 8, 10), the first of `features.NECK`, means of 2x2 cells.
            neck32: (v, 128, 8, 10), the second of `features.NECK`.
            evidence: (v, kinds, 8, 10) scores in [0, 1].
        """
        x = torch.cat([self.near(neck16), self.far(neck32), self.kinds(evidence)], 1)
        return self.map(self.fade(x)) + self.place

    def forward(
        self, seen: Tensor, target: Tensor, text: Tensor, marks: Tensor, others: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the logits of directions and scene.

        A direction is a mark or "elsewhere". The scene's logit says if the image leads to the
        target.

        Args:
            seen: (v, width, 8, 10), the map of v images, from `read`.
            target: (v, t, 80) the detector's scores of t targets in the cells.
            text: (v, t, 64) embeddings of the targets.
            marks: (v, m, MARK_FIELDS), see `labels.marks_of`.
            others: (v, OTHERS_FIELDS), see `collect.Views`.

        Returns:
            (v, t, m + 1) logits, very low for a missing mark; (v, t) logits of the scene.
        """
        v, t, m = text.shape[0], text.shape[1], marks.shape[1]
        cells = seen.flatten(2).transpose(1, 2)  # (v, 80, width)
        at_marks = bilinear_weights(marks[..., :2]) @ cells  # (v, m, width), the map at the marks
        tokens = self.mark(torch.cat([self.drop(at_marks), mark_features(marks)], -1))
        rest = self.rest(others_features(others))[:, None]
        # (v, t, m + 1, width): the tokens of each target have its text added.
        tokens = torch.cat([tokens, rest], 1)[:, None] + self.text(text)[:, :, None]
        is_mark = torch.cat([marks[..., -1], torch.ones_like(marks[:, :1, -1])], 1)  # (v, m + 1)
        middle = torch.full_like(marks[:, :1, :2], 0.5)  # position of the token for "elsewhere"
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
        # Attention over cells: queries, keys and values, scores by position and by the target's
        # score in the cell, and the output.
        self.ask, self.key_value = nn.Linear(width, width), nn.Linear(width, 2 * width)
        self.bias = nn.Sequential(nn.Linear(4, 16), nn.ReLU(), nn.Linear(16, heads))
        self.on_target = nn.Parameter(torch.zeros(heads))
        self.answer = nn.Linear(width + heads, width)
        # Attention over tokens: queries, keys and values; the output.
        self.mix, self.mixed = nn.Linear(width, 3 * width), nn.Linear(width, width)
        # The feed-forward step.
        self.step = nn.Sequential(
            nn.Linear(width, 2 * width), nn.ReLU(), nn.Dropout(0.1), nn.Linear(2 * width, width)
        )

    def forward(
        self, x: Tensor, cells: Tensor, away: Tensor, target: Tensor, is_mark: Tensor
    ) -> Tensor:
        """Return the new tokens.

        Args:
            x: (v, t, n, width) tokens of v images and t targets.
            cells: (v, 80, width) the map.
            away: (v, n, 80, 2) position of each token minus that of each cell.
            target: (v, t, 80) scores of the targets in the cells.
            is_mark: (v, n) 1 for a token that exists.
        """
        v, t, n, width = x.shape
        h, d = self.heads, width // self.heads
        # Attention over cells: h heads, d values in each.
        ask = self.ask(self.norms[0](x)).reshape(v, t * n, h, d).transpose(1, 2)
        key, value = self.key_value(cells).chunk(2, -1)
        key, value = (y.reshape(v, -1, h, d).transpose(1, 2) for y in (key, value))
        score = (ask @ key.transpose(2, 3)).reshape(v, h, t, n, -1) * d**-0.5
        offset = torch.cat([away, away.abs()], -1)
        score = score + self.bias(offset).permute(0, 3, 1, 2)[:, :, None]
        score = score + self.on_target.reshape(1, -1, 1, 1, 1) * target[:, None, :, None]
        p = score.softmax(-1)  # (v, h, t, n, 80)
        # The map at the tokens' cells, and the target's score there.
        found = (p.reshape(v, h, t * n, -1) @ value).transpose(1, 2).reshape(v, t, n, width)
        seen = (p * target[:, None, :, None]).sum(-1).permute(0, 2, 3, 1)  # (v, t, n, heads)
        x = x + self.answer(torch.cat([found, seen], -1))

        # Attention over tokens, then the feed-forward step.
        query, key, value = self.mix(self.norms[1](x)).chunk(3, -1)
        score = query @ key.transpose(2, 3) * width**-0.5 - _BIG * (1.0 - is_mark[:, None, None])
        x = x + self.mixed(score.softmax(-1) @ value)
        return x + self.step(self.norms[2](x))


def mark_features(marks: Tensor) -> Tensor:
    """Return features of marks, (…, _MARK_FEATURES), from (…, MARK_FIELDS) of `labels.marks_of`."""
    u, v, bearing, distance, path, gain, is_mark = marks.unbind(-1)
    waves = [wave(k * torch.pi * u) for k in (1, 2) for wave in (torch.sin, torch.cos)]
    offset = [u, v, bearing, bearing.abs(), distance / _FAR_M, torch.log1p(distance), *waves]
    worth = _path_and_gain_features(path, gain)
    return torch.stack([*offset, (path - distance) / _FAR_M, *worth, is_mark], -1)


def others_features(others: Tensor) -> Tensor:
    """Return features of all frontiers without a mark, (…, _OTHERS_FEATURES).

    `others` is (…, OTHERS_FIELDS): number, least path [m] and largest gain [m²].
    """
    count, path, gain = others.unbind(-1)
    return torch.stack([torch.log1p(count), *_path_and_gain_features(path, gain)], -1)


def _path_and_gain_features(path: Tensor, gain: Tensor) -> list[Tensor]:
    """Return features of path [m] and gain [m²], the last one as `edge.policies.search` scores."""
    wide = torch.sqrt(gain.clamp(min=0.0) + 1e-6)
    return [path / _FAR_M, torch.log1p(path), gain / _WIDE_M2, wide, wide / (1.0 + path)]


def cell_centres() -> Tensor:
    """Return the cells' centres, (80, 2): u and v as shares of the image, row by row."""
    h, w = GRID_HW
    v, u = torch.meshgrid((torch.arange(h) + 0.5) / h, (torch.arange(w) + 0.5) / w, indexing="ij")
    return torch.stack([u, v], -1).reshape(-1, 2)


def bilinear_weights(at: Tensor) -> Tensor:
    """Return weights (…, 80) that interpolate the cells at positions (…, 2).

    A position is u and v as shares of the image; outside the cell centres the nearest one counts.
    """
    h, w = GRID_HW
    columns = torch.arange(w, dtype=at.dtype, device=at.device) + 0.5
    rows = torch.arange(h, dtype=at.dtype, device=at.device) + 0.5
    x = (at[..., :1] * w).clamp(0.5, w - 0.5)
    y = (at[..., 1:] * h).clamp(0.5, h - 0.5)
    across = torch.relu(1.0 - (x - columns).abs())
    down = torch.relu(1.0 - (y - rows).abs())
    return (down[..., :, None] * across[..., None, :]).flatten(-2)
