"""A vision-language model as `transformers` runs it, which its ONNX files are compared with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn

from exporters.vlm_parity import Question, Shown, places_of


class TorchOriginal:
    """Asked as a whole; see `exporters.vlm_parity.Original`.

    Attributes:
        prepare: (h, w, 3) uint8 → inputs of the vision encoder's ONNX.
        merge: how many patches a token is high and wide.
    """

    def __init__(self, model: nn.Module, prepare: Callable[[np.ndarray], dict]) -> None:
        self._model, self.prepare = model, prepare
        visual = getattr(model.model, "visual", None)
        self.merge = 1 if visual is None else visual.spatial_merge_size

    def show(self, rgb: np.ndarray) -> Shown:
        """A picture, (h, w, 3) uint8, made ready and looked at."""
        feeds = self.prepare(rgb)
        with torch.inference_mode():
            found = self._model.model.get_image_features(**_inputs(feeds)).pooler_output
        rows = found if torch.is_tensor(found) else torch.cat(tuple(found))
        return Shown(feeds, rows.reshape(-1, rows.shape[-1]).numpy())

    def logits(self, question: Question, shown: Shown) -> np.ndarray:
        """(v,) float32 of the token behind the question."""
        ids = torch.from_numpy(question.ids(len(shown.features)))
        more = {}
        if shown.grid is not None:
            more["mm_token_type_ids"] = (ids == question.image).to(torch.int32)
        with torch.inference_mode():
            found = self._model(
                input_ids=ids, attention_mask=torch.ones_like(ids), **_inputs(shown.feeds), **more
            )
        return found.logits[0, -1].numpy()

    def decoder_feeds(self, question: Question, shown: Shown) -> dict[str, np.ndarray]:
        """Inputs of the decoder's ONNX for the whole question, with nothing before it."""
        ids = question.ids(len(shown.features))
        with torch.inference_mode():
            rows = self._model.get_input_embeddings()(torch.from_numpy(ids)).numpy().copy()
        rows[ids == question.image] = shown.features
        heads, size = cache_shape(self._model.config.get_text_config())
        layers = self._model.config.get_text_config().num_hidden_layers
        empty = np.zeros((1, heads, 0, size), np.float32)
        return {
            "inputs_embeds": rows,
            "attention_mask": np.ones(ids.shape, np.int64),
            "position_ids": places_of(ids, question.image, shown.grid, self.merge),
            **{
                f"past_key_values.{layer}.{kind}": empty
                for layer in range(layers)
                for kind in ("key", "value")
            },
        }


def cache_shape(text: Any) -> tuple[int, int]:
    """(heads, size) of a language model's keys and values, by its configuration."""
    size = getattr(text, "head_dim", None) or text.hidden_size // text.num_attention_heads
    return text.num_key_value_heads, size


def _inputs(feeds: dict[str, np.ndarray]) -> dict[str, Any]:
    """Of the vision encoder's ONNX → those of transformers, which calls the grid otherwise."""
    renamed = {"grid_thw": "image_grid_thw"}
    return {renamed.get(key, key): torch.from_numpy(value) for key, value in feeds.items()}
