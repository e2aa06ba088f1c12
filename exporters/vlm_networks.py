"""The networks of a vision-language model as traceable modules, one for each ONNX file.

Weights and layers are those of `transformers`. Masks, positions and the cache of keys and values
are written here, because tracing cannot follow the originals.
"""

from __future__ import annotations

from inspect import signature

import torch
from torch import Tensor, nn

MASKED = -1e4
"""Added to the attention score of positions that must not be seen. -inf gives NaN in a row without
others."""


class Decoder(nn.Module):
    """Language model that continues from cached tokens.

    Inputs: `inputs_embeds` (b, n, d) of n new tokens, `attention_mask` (b, past + n),
    `position_ids` (b, n), or (3, b, n) for positions of three numbers, for each of the first
    `deepstack` layers (b, n, d) that is added to its output, and for each layer keys and values
    (b, heads, past, size). Outputs: `logits` (b, 1, v) of the last token, and keys and values
    (b, heads, past + n, size).

    Published decoders give the logits of every token. Only the last ones are used, and for a long
    prompt the others cost much time and memory.
    """

    def __init__(self, text_model: nn.Module, lm_head: nn.Module, deepstack: int = 0) -> None:
        super().__init__()
        self.deepstack = deepstack
        # The name of the cache differs between transformers' releases.
        known = signature(text_model.layers[0].forward).parameters
        self.cache_name = "cache" if "cache" in known else "past_key_values"
        self.layers, self.norm = text_model.layers, text_model.norm
        self.rotary_emb, self.lm_head = text_model.rotary_emb, lm_head

    def forward(
        self, inputs_embeds: Tensor, attention_mask: Tensor, position_ids: Tensor, *more: Tensor
    ) -> tuple[Tensor, ...]:
        added, cache = more[: self.deepstack], _Cache(more[self.deepstack :])
        total, n = attention_mask.shape[1], inputs_embeds.shape[1]
        positions = torch.arange(total)
        # (n, total): a new token sees itself and all tokens before it.
        causal = positions[None] <= positions[total - n :, None]
        seen = causal & attention_mask[:, None, None, :].to(torch.bool)
        mask = torch.where(seen, 0.0, MASKED)
        rotation = self.rotary_emb(inputs_embeds, position_ids)
        hidden = inputs_embeds
        for i, layer in enumerate(self.layers):
            hidden = layer(
                hidden,
                attention_mask=mask,
                position_embeddings=rotation,
                **{self.cache_name: cache},
            )
            if i < self.deepstack:
                hidden = hidden + added[i]
        logits = self.lm_head(self.norm(hidden[:, -1:]))
        return logits, *cache.present


class _Cache:
    """Keys and values of earlier tokens, with the new ones appended; a `transformers.Cache`.

    Attributes:
        present: keys and values of each layer in turn, with the new tokens.
    """

    def __init__(self, past: tuple[Tensor, ...]) -> None:
        self._past = past
        self.present: list[Tensor] = []

    def update(
        self, key: Tensor, value: Tensor, layer: int, *_: object, **__: object
    ) -> tuple[Tensor, Tensor]:
        """Append a layer's keys and values, like `transformers.Cache.update`."""
        both = self._past[2 * layer : 2 * layer + 2]
        joined = [torch.cat(pair, dim=2) for pair in zip(both, (key, value), strict=True)]
        self.present += joined
        return joined[0], joined[1]


class Embedding(nn.Module):
    """`input_ids` (b, n) int64 → `inputs_embeds` (b, n, d)."""

    def __init__(self, embed_tokens: nn.Module) -> None:
        super().__init__()
        self.embed_tokens = embed_tokens

    def forward(self, input_ids: Tensor) -> Tensor:
        return self.embed_tokens(input_ids)


class Idefics3Vision(nn.Module):
    """Vision encoder of Idefics3 and SmolVLM.

    Inputs, for i images in each of b prompts: `pixel_values` (b, i, 3, h, w),
    `pixel_attention_mask` (b, i, h, w) bool, False for padding. Output: `image_features` (b·i,
    tokens, d). A patch is visible if any of its pixels is. Images of padding only are not removed,
    since a scorer shows one image.
    """

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.vision_model, self.connector = model.vision_model, model.connector
        self.places = _Idefics3Places(model.vision_model.embeddings.num_patches_per_side)

    def forward(self, pixel_values: Tensor, pixel_attention_mask: Tensor) -> Tensor:
        vision, patch = self.vision_model, self.vision_model.patch_size
        images = pixel_values.flatten(0, 1)
        pixels = pixel_attention_mask.flatten(0, 1)[:, None].to(images.dtype)
        # (images, rows, columns) of patches, 1 if the patch is visible.
        visible = nn.functional.max_pool2d(pixels, patch, patch)[:, 0]
        patches = vision.embeddings.patch_embedding(images).flatten(2).transpose(1, 2)
        hidden = patches + vision.embeddings.position_embedding(self.places(visible))
        mask = ((1.0 - visible.flatten(1)) * MASKED)[:, None, None, :]
        encoded = vision.encoder(inputs_embeds=hidden, attention_mask=mask).last_hidden_state
        return self.connector(vision.post_layernorm(encoded))


class _Idefics3Places(nn.Module):
    """Positions of the visible patches: (images, rows, columns) of 0 and 1 → (images, n) int64."""

    def __init__(self, side: int) -> None:
        super().__init__()
        self.side = side
        # The same division of 0..1 as in transformers, with its rounding errors.
        bounds = torch.arange(1 / side, 1.0, 1 / side)
        self.register_buffer("bounds", bounds, persistent=False)

    def forward(self, seen: Tensor) -> Tensor:
        rows, columns = self._along(seen[:, :, 0]), self._along(seen[:, 0, :])
        places = rows[:, :, None] * self.side + columns[:, None, :]
        return (places * seen.to(torch.int64)).flatten(1)

    def _along(self, seen: Tensor) -> Tensor:
        """Return the position of each patch along one axis, 0 to `side` - 1, (images, n).

        `seen` (images, n) is 1 for the visible patches, which are spread evenly over the positions.
        """
        step = 1.0 / seen.sum(dim=1, keepdim=True)
        share = torch.arange(seen.shape[1]).to(torch.float32)[None] * step
        share = share.clamp(max=1.0 - 1e-6)
        return (share[..., None] >= self.bounds).to(torch.int64).sum(dim=-1)


class Qwen2Vision(nn.Module):
    """Vision encoder of Qwen2-VL, for one still image.

    Inputs: `pixel_values` (n, 3·2·patch²), `grid_thw` (1, 3) int64. Output: `image_features` (n /
    merge², d).
    """

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.visual = model.visual
        self.places = _Qwen2Rotation(self.visual)

    def forward(self, pixel_values: Tensor, grid_thw: Tensor) -> Tensor:
        visual = self.visual
        rotation = self.places(grid_thw)
        # A convolution whose stride is its kernel size is a matrix product. The first axis keeps
        # linear layers as MatMul too: without it they become Gemm, which is not quantized.
        weight = visual.patch_embed.proj.weight
        hidden = nn.functional.linear(pixel_values[None], weight.flatten(1))
        for block in visual.blocks:
            hidden = hidden + _attend(block.attn, block.norm1(hidden), rotation)
            hidden = hidden + block.mlp(block.norm2(hidden))
        merger = visual.merger
        return merger.mlp(merger.ln_q(hidden).reshape(1, -1, merger.hidden_size))[0]


class Qwen3Vision(nn.Module):
    """Vision encoder of Qwen3-VL, for one still image.

    Inputs as `Qwen2Vision`. Outputs: `image_features` (n / merge², d), and of each layer that the
    configuration names another array of this shape (DeepStack), for the first layers of the
    language model.
    """

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.visual = model.visual
        self.places = _Qwen3Places(self.visual)

    def forward(self, pixel_values: Tensor, grid_thw: Tensor) -> tuple[Tensor, ...]:
        visual, proj, deepstack = self.visual, self.visual.patch_embed.proj, []
        rotation, corners, weights = self.places(grid_thw)
        learned = (visual.pos_embed(corners) * weights[..., None]).sum(dim=0)
        # A matrix product in place of the convolution: see `Qwen2Vision`.
        hidden = nn.functional.linear(pixel_values[None], proj.weight.flatten(1), proj.bias)
        hidden = hidden + learned
        mergers = dict(
            zip(visual.deepstack_visual_indexes, visual.deepstack_merger_list, strict=True)
        )
        for i, block in enumerate(visual.blocks):
            hidden = hidden + _attend(block.attn, block.norm1(hidden), rotation)
            hidden = hidden + block.mlp(block.norm2(hidden))
            if i in mergers:
                deepstack.append(_merged(mergers[i], hidden))
        return _merged(visual.merger, hidden), *deepstack


def _merged(merger: nn.Module, x: Tensor) -> Tensor:
    """Return the tokens of Qwen3-VL's merger, (1, n, d) → (n / merge², out)."""
    if not merger.use_postshuffle_norm:
        x = merger.norm(x)
    x = x.reshape(1, -1, merger.hidden_size)
    if merger.use_postshuffle_norm:
        x = merger.norm(x)
    return merger.linear_fc2(merger.act_fn(merger.linear_fc1(x)))[0]


class _Qwen2Rotation(nn.Module):
    """Rotary embedding: `grid_thw` → cosines and sines per patch, (n, 1, head size) each."""

    def __init__(self, visual: nn.Module) -> None:
        super().__init__()
        self.merge = visual.spatial_merge_size
        self.register_buffer("inv_freq", visual.rotary_pos_emb.inv_freq, persistent=False)

    def forward(self, grid_thw: Tensor) -> tuple[Tensor, Tensor]:
        return self._rotation(self._places(grid_thw))

    def _places(self, grid_thw: Tensor) -> Tensor:
        """Return (n, 2) int64, row and column of each patch, in the order of the patches."""
        rows, columns, m = grid_thw[0, 1], grid_thw[0, 2], self.merge
        row = torch.arange(rows)[:, None].expand(rows, columns)
        column = torch.arange(columns)[None, :].expand(rows, columns)
        squares = (rows // m, m, columns // m, m)  # patches come in the order of their squares
        ordered = [part.reshape(squares).transpose(1, 2).flatten() for part in (row, column)]
        return torch.stack(ordered, dim=-1)

    def _rotation(self, places: Tensor) -> tuple[Tensor, Tensor]:
        angles = (places[..., None].float() * self.inv_freq).flatten(1)
        angles = torch.cat((angles, angles), dim=-1)[:, None]
        return angles.cos(), angles.sin()


class _Qwen3Places(_Qwen2Rotation):
    """`grid_thw` → rotary embedding, and where each patch is in the grid of learned positions.

    The grid is stretched over the image: a patch is between four learned positions, (4, n) int64,
    with weights (4, n).
    """

    def __init__(self, visual: nn.Module) -> None:
        super().__init__(visual)
        self.side = visual.num_grid_per_side

    def forward(self, grid_thw: Tensor) -> tuple[tuple[Tensor, Tensor], Tensor, Tensor]:
        places, last = self._places(grid_thw), self.side - 1
        # With one row of patches, all are at 0.
        scaled = places.float() * last / (grid_thw[0, 1:] - 1).clamp(min=1)
        low = scaled.floor().clamp(max=last)
        share, low = scaled - low, low.to(torch.int64)
        high = (low + 1).clamp(max=last)
        taken = [(low, 1.0 - share), (high, share)]
        corners = [row[:, 0] * self.side + column[:, 1] for row, _ in taken for column, _ in taken]
        weights = [row[:, 0] * column[:, 1] for _, row in taken for _, column in taken]
        return self._rotation(places), torch.stack(corners), torch.stack(weights)


def _attend(attention: nn.Module, x: Tensor, rotation: tuple[Tensor, Tensor]) -> Tensor:
    """Return Qwen2-VL's attention over all patches of one image, (1, n, d) → (1, n, d)."""
    heads = attention.num_heads
    q, k, v = attention.qkv(x).reshape(-1, 3, heads, x.shape[-1] // heads).unbind(1)
    q, k = (part * rotation[0] + _half_turned(part) * rotation[1] for part in (q, k))
    q, k, v = (part.transpose(0, 1) for part in (q, k, v))
    scores = torch.matmul(q, k.transpose(1, 2)) * attention.scaling
    mixed = torch.matmul(scores.softmax(dim=-1), v)
    return attention.proj(mixed.transpose(0, 1).flatten(1)[None])


def _half_turned(x: Tensor) -> Tensor:
    """Turn the pairs (i, i + size / 2) of the last axis by 90 degrees, for a rotary embedding."""
    first, second = x.chunk(2, dim=-1)
    return torch.cat((-second, first), dim=-1)
