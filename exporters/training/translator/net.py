"""Network of the small translator: a transformer from words to a formula, and back.

Encoder and decoder share one table of words and formula tokens (Vaswani et al., "Attention is all
you need", 2017; with norms before the sublayers). One network does both directions; the decoder's
first token selects one. The reverse direction is used to check a translation against its sentence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

MASKED = -1e4
"""Added to the attention score of positions that must not be seen."""


@dataclass(frozen=True, slots=True)
class Size:
    """Size of the network.

    Attributes:
        width: length of a token's vector.
        heads: number of attention heads.
        longest: largest number of tokens of a source or a target.
        dropout: share of the values that are dropped in training.
    """

    width: int = 128
    heads: int = 4
    encoder_layers: int = 3
    decoder_layers: int = 2
    longest: int = 96
    dropout: float = 0.1


class Attention(nn.Module):
    """Multi-head attention; keys and values (b, heads, n, d) may come from another sequence."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.heads = size.heads
        self.query = nn.Linear(size.width, size.width)
        self.key = nn.Linear(size.width, size.width)
        self.value = nn.Linear(size.width, size.width)
        self.out = nn.Linear(size.width, size.width)

    def keys_and_values(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Map (b, n, width) to two (b, heads, n, width / heads)."""
        return self._split(self.key(x)), self._split(self.value(x))

    def forward(self, x: Tensor, keys: Tensor, values: Tensor, mask: Tensor | None) -> Tensor:
        """Attend to keys and values; `mask` is added to the scores (b or 1, 1, n or 1, m)."""
        query = self._split(self.query(x))
        scores = query @ keys.transpose(-1, -2) / math.sqrt(query.shape[-1])
        if mask is not None:
            scores = scores + mask
        mixed = (scores.softmax(-1) @ values).transpose(1, 2)
        return self.out(mixed.flatten(2))

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.heads, x.shape[-1] // self.heads)).transpose(1, 2)


class _Feed(nn.Sequential):
    """Feed-forward step for each token."""

    def __init__(self, size: Size) -> None:
        super().__init__(
            nn.Linear(size.width, 4 * size.width), nn.GELU(), nn.Linear(4 * size.width, size.width)
        )


class EncoderLayer(nn.Module):
    """Attention over the source, and a feed-forward step."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.attention, self.feed = Attention(size), _Feed(size)
        self.norms = nn.ModuleList(nn.LayerNorm(size.width) for _ in range(2))
        self.drop = nn.Dropout(size.dropout)

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        y = self.norms[0](x)
        x = x + self.drop(self.attention(y, *self.attention.keys_and_values(y), mask))
        return x + self.drop(self.feed(self.norms[1](x)))


class DecoderLayer(nn.Module):
    """Attention over the target so far, attention over the source, and a feed-forward step."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.attention, self.across, self.feed = Attention(size), Attention(size), _Feed(size)
        self.norms = nn.ModuleList(nn.LayerNorm(size.width) for _ in range(3))
        self.drop = nn.Dropout(size.dropout)

    def forward(
        self, x: Tensor, past: tuple[Tensor, Tensor] | None, causal: Tensor,
        across: tuple[Tensor, Tensor], mask: Tensor | None,
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:  # fmt: skip
        """Return the new `x`, and its keys and values appended to those of the past.

        Args:
            x: (b, n, width) new tokens of the target.
            past: keys and values of earlier tokens; None for none.
            causal: mask, which hides later tokens.
            across: keys and values of the source, for the cross-attention.
            mask: hides padding of the source.
        """
        y = self.norms[0](x)
        own = self.attention.keys_and_values(y)
        if past is not None:
            own = tuple(torch.cat(pair, dim=2) for pair in zip(past, own, strict=True))
        x = x + self.drop(self.attention(y, *own, causal))
        x = x + self.drop(self.across(self.norms[1](x), *across, mask))
        return x + self.drop(self.feed(self.norms[2](x))), own


class Translator(nn.Module):
    """The network in training, for both directions.

    `Encoder` and `Decoder` are its exported parts.
    """

    def __init__(self, tokens: int, size: Size) -> None:
        super().__init__()
        self.size = size
        # Vectors of tokens (`tokens` of them), and of positions in the text.
        self.table = nn.Embedding(tokens, size.width)
        self.places = nn.Embedding(size.longest, size.width)
        self.encoder = nn.ModuleList(EncoderLayer(size) for _ in range(size.encoder_layers))
        self.decoder = nn.ModuleList(DecoderLayer(size) for _ in range(size.decoder_layers))
        # Norms of the encoder's output and of the decoder's output.
        self.read, self.wrote = nn.LayerNorm(size.width), nn.LayerNorm(size.width)
        self.drop = nn.Dropout(size.dropout)
        nn.init.normal_(self.table.weight, std=size.width**-0.5)
        nn.init.normal_(self.places.weight, std=0.02)

    def embedded(self, tokens: Tensor, first: int | Tensor = 0) -> Tensor:
        """Return the vectors (b, n, width) of tokens (b, n), the first at position `first`."""
        positions = torch.arange(tokens.shape[1]) + first
        scale = math.sqrt(self.size.width)
        return self.drop(self.table(tokens) * scale + self.places(positions))

    def encode(self, source: Tensor, mask: Tensor | None = None) -> list[tuple[Tensor, Tensor]]:
        """Map `source` (b, n) to keys and values of every decoder layer's cross-attention."""
        x = self.embedded(source)
        for layer in self.encoder:
            x = layer(x, mask)
        x = self.read(x)
        return [layer.across.keys_and_values(x) for layer in self.decoder]

    def forward(self, source: Tensor, target: Tensor, padding: int) -> Tensor:
        """Return logits (b, m, tokens) of the token after each token of `target` (b, m)."""
        mask = torch.where(source == padding, MASKED, 0.0)[:, None, None, :]
        across = self.encode(source, mask)
        n = target.shape[1]
        causal = torch.full((n, n), MASKED).triu(1)
        x = self.embedded(target)
        for layer, pair in zip(self.decoder, across, strict=True):
            x, _ = layer(x, None, causal, pair, mask)
        return self.wrote(x) @ self.table.weight.T


class Encoder(nn.Module):
    """`source` (1, n) int64 → `across` (2 x layers, 1, heads, n, d), for the cross-attention."""

    def __init__(self, net: Translator) -> None:
        super().__init__()
        self.net = net

    def forward(self, source: Tensor) -> Tensor:
        return torch.stack([part for pair in self.net.encode(source) for part in pair])


class Decoder(nn.Module):
    """Decoder step with a cache.

    Inputs: `target` (b, m) int64, `past` (2 x layers, b, heads, p, d) and `across`. Outputs:
    `logits` (b, m, tokens), and `present`, the `past` of the next call.
    """

    def __init__(self, net: Translator) -> None:
        super().__init__()
        self.net = net
        self.head = nn.Linear(net.size.width, net.table.num_embeddings, bias=False)
        self.head.weight = nn.Parameter(net.table.weight.detach().clone())

    def forward(self, target: Tensor, past: Tensor, across: Tensor) -> tuple[Tensor, Tensor]:
        before, new = past.shape[3], target.shape[1]
        x = self.net.embedded(target, before)
        # Later tokens are hidden, (new, before + new).
        ahead = torch.arange(before + new)[None] > torch.arange(new)[:, None] + before
        causal = torch.where(ahead, MASKED, 0.0)
        kept: list[Tensor] = []
        for i, layer in enumerate(self.net.decoder):
            # Entries 2i and 2i + 1 are keys and values of layer i.
            own, other = (past[2 * i], past[2 * i + 1]), (across[2 * i], across[2 * i + 1])
            x, pair = layer(x, own, causal, other, None)
            kept += pair
        return self.head(self.net.wrote(x)), torch.stack(kept)
