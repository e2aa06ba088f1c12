"""The decoder network of a language model with its key-value cache, so no token is read twice.

The decoder reads tokens, as ids or as embeddings (rows). For each token and layer it returns a key
and a value, which are its input when it reads the next tokens.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from edge.perception.runtime.deadline import InferenceTimeout
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import DTYPES
from edge.perception.scoring.vlm.files import ModelFiles

# Names, or beginnings of names, of the decoder's inputs and outputs.
_PAST, _PRESENT, _LOGITS = "past_key_values.", "present.", "logits"
DEEPSTACK = "deepstack_features_"
"""Beginning of the names of the vision encoder's outputs that are inputs of the decoder, too: its
first layers add them to the image's tokens (DeepStack, Qwen3-VL)."""


class KeyValueCache(NamedTuple):
    """Keys and values of the tokens read so far.

    Attributes:
        arrays: (1, heads, length, d) each, by name of the decoder's input.
    """

    length: int
    arrays: dict[str, np.ndarray]

    def first(self, length: int) -> KeyValueCache:
        """Return the cache of the first tokens only."""
        if length >= self.length:
            return self
        cut = {name: np.ascontiguousarray(a[:, :, :length]) for name, a in self.arrays.items()}
        return KeyValueCache(length, cut)


class Decoder:
    """A decoder with its key-value cache as input and output, and the embedding of its tokens.

    Args:
        embedding: session of the token embedding; None: the decoder embeds tokens itself.
        deadline: time limit of the runs.

    Attributes:
        takes_ids: True if the decoder embeds tokens itself.
        deepstack: names of the inputs for DeepStack. A row then has the embedding and after it, for
            each of these, as many numbers.
        nothing: the empty cache.

    Raises:
        ModelError: inputs and outputs are not those of a published decoder.
    """

    def __init__(
        self, files: ModelFiles, session: Any, embedding: Any | None, deadline: InferenceTimeout
    ) -> None:
        self._files, self._session, self._embedding = files, session, embedding
        self._deadline = deadline
        self._inputs = {value.name: value for value in session.get_inputs()}
        self._outputs = [value.name for value in session.get_outputs()]
        self.takes_ids = embedding is None
        self.deepstack = sorted(name for name in self._inputs if name.startswith(DEEPSTACK))
        self._check()
        self._presents = [name for name in self._outputs if name.startswith(_PRESENT)]
        self.nothing = KeyValueCache(0, dict(self._empty_arrays()))

    def _check(self) -> None:
        """Raise ModelError if inputs and outputs are not those of a published decoder."""
        first = "input_ids" if self.takes_ids else "inputs_embeds"
        pasts = {name for name in self._inputs if name.startswith(_PAST)}
        known = {first, "attention_mask", "position_ids", "num_logits_to_keep", *self.deepstack}
        known |= pasts
        needed = {_LOGITS, *(_PRESENT + name.removeprefix(_PAST) for name in pasts)}
        if first not in self._inputs or not pasts:
            fault = f"has no input {first if pasts else _PAST + 'N.key'}"
        elif unknown := sorted(self._inputs.keys() - known):
            fault = f"needs an unknown input {unknown[0]!r:.40}"
        elif lacking := sorted(needed - set(self._outputs)):
            fault = f"has no output {lacking[0]}"
        else:
            return
        raise ModelError(
            f"{self._files.folder}: model {self._files.name}: its decoder {fault}; take another "
            "model, with a file like decoder_model_merged.onnx"
        )

    def _empty_arrays(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield an empty cache, shaped by the decoder or else by the configuration."""
        config = self._files.text_config
        heads = config.get("num_key_value_heads", config.get("num_attention_heads"))
        size = config.get("head_dim")
        if size is None and "hidden_size" in config and "num_attention_heads" in config:
            size = config["hidden_size"] // config["num_attention_heads"]
        for name, value in self._inputs.items():
            if name.startswith(_PAST):
                # Number of heads and their size, as the decoder declares them, else as configured.
                n, d = (
                    declared if isinstance(declared, int) else known
                    for declared, known in zip(
                        (value.shape[1], value.shape[3]), (heads, size), strict=True
                    )
                )
                if not (isinstance(n, int) and isinstance(d, int)):
                    raise ModelError(
                        f"{self._files.folder}: model {self._files.name}: num_key_value_heads and "
                        "head_dim are neither in the decoder nor in config.json; add them there"
                    )
                yield name, np.empty((1, n, 0, d), DTYPES[value.type])

    def embed(self, ids: np.ndarray) -> np.ndarray:
        """Embed (n,) ids as (n, d) rows; return the ids themselves if the decoder takes them."""
        if self._embedding is None:
            return ids
        name = self._embedding.get_inputs()[0].name
        rows = self._embedding.run(None, {name: ids[None]}, self._deadline.options)[0][0]
        return np.pad(rows, ((0, 0), (0, len(self.deepstack) * rows.shape[1])))

    def read(self, rows: np.ndarray, places: np.ndarray, past: KeyValueCache) -> KeyValueCache:
        """Read more tokens; return the cache with the new tokens.

        Args:
            rows: n tokens, at least one: (n, d) embeddings, or (n,) ids if `takes_ids`.
            places: (3, n) int64; see `pictures.positions`.
            past: cache of the tokens read before.
        """
        return self._run(rows, places, past, self._presents)[0]

    def next_logits(self, rows: np.ndarray, places: np.ndarray, past: KeyValueCache) -> np.ndarray:
        """Return (v,) float32 for the token that comes after `rows`; see `read`."""
        logits = self._run(rows, places, past, [_LOGITS])[1]
        return logits.reshape(-1, logits.shape[-1])[-1].astype(np.float32)

    def _run(
        self, rows: np.ndarray, places: np.ndarray, past: KeyValueCache, wanted: Sequence[str]
    ) -> tuple[KeyValueCache, np.ndarray]:
        """Run the decoder on more tokens; see `read`.

        Returns:
            (cache of the wanted key and value outputs, logits or an empty array).
        """
        n, length = len(rows), past.length + len(rows)
        parts = np.split(rows[None], 1 + len(self.deepstack), axis=-1)
        offered = {
            "input_ids": rows[None],
            **dict(zip(("inputs_embeds", *self.deepstack), parts, strict=True)),
            "attention_mask": np.ones((1, length), np.int64),
            "position_ids": self._as_position_ids(places),
            "num_logits_to_keep": np.array(1, np.int64),
        }
        feeds = {
            name: offered[name].astype(DTYPES[value.type], copy=False)
            for name, value in self._inputs.items()
            if name in offered
        }
        found = self._session.run(list(wanted), {**feeds, **past.arrays}, self._deadline.options)
        by_name = dict(zip(wanted, found, strict=True))
        logits = by_name.pop(_LOGITS, np.empty(0, np.float32))
        kept = {_PAST + name.removeprefix(_PRESENT): a for name, a in by_name.items()}
        if any(a.shape[2] != length for a in kept.values()):
            raise ModelError(
                f"model {self._files.name}: its decoder read {length} tokens ({n} of them now), "
                "but returns a cache of another length; take another model"
            )
        return KeyValueCache(length, kept), logits

    def _as_position_ids(self, places: np.ndarray) -> np.ndarray:
        """Return positions as the decoder takes them: (1, n), or (3, 1, n).

        Models with M-RoPE, a rotary embedding by time, row and column, take three for each token.
        """
        declared = self._inputs.get("position_ids")
        threefold = declared is not None and len(declared.shape) == 3
        return places[:, None] if threefold else places[:1]
