"""A small Llama with random weights, as ONNX and as GGUF: the same model for two runtimes.

The network has RMSNorm, rotary embedding and SwiGLU, as in Touvron et al. 2023 ("LLaMA", section
2.2).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from tiny_vlm import F32, I64, Graph

EPSILON = 1e-5  # of the RMSNorm
THETA = 1e4  # base of the rotary embedding
CONTEXT = 2048  # tokens
_SPECIAL = ("<unk>", "<s>", "</s>")
_BYTES = tuple(f"<0x{byte:02X}>" for byte in range(256))
_UNKNOWN, _CONTROL, _BYTE, _NORMAL = 2, 3, 6, 1
"""Kinds of tokens, as llama.cpp counts them."""


class LlamaSize(NamedTuple):
    """Dimensions of a model; SmolLM2-135M has 576, 9, 30, 1536."""

    hidden: int
    heads: int
    layers: int
    inner: int
    tokens: int


def weights(size: LlamaSize, seed: int = 0) -> dict[str, np.ndarray]:
    """Return random weights by llama.cpp's names, (out, in) float32.

    They are for the rotary embedding of Hugging Face, which rotates the two halves of a row.
    """
    rng = np.random.default_rng(seed)
    h, f, v = size.hidden, size.inner, size.tokens
    shapes = {"token_embd": (v, h), "output": (v, h)}
    for layer in range(size.layers):
        block = {"attn_q": (h, h), "attn_k": (h, h), "attn_v": (h, h), "attn_output": (h, h),
                 "ffn_gate": (f, h), "ffn_up": (f, h), "ffn_down": (h, f)}  # fmt: skip
        shapes |= {f"blk.{layer}.{name}": shape for name, shape in block.items()}
    matrices = {
        name: (rng.normal(size=shape) * shape[1] ** -0.5).astype(np.float32)
        for name, shape in shapes.items()
    }
    norms = [
        "output_norm",
        *(f"blk.{i}.{n}_norm" for i in range(size.layers) for n in ("attn", "ffn")),
    ]
    return matrices | {name: rng.uniform(0.5, 1.5, h).astype(np.float32) for name in norms}


def onnx_of(size: LlamaSize, parameters: dict[str, np.ndarray]) -> Any:
    """Return the ONNX decoder, with keys and values as inputs and outputs.

    It has the same operators as our exports.
    """
    g, width = Graph(np.random.default_rng(0), F32), size.hidden // size.heads
    epsilon, two = g.real(EPSILON), g.real(2.0)

    def product(x: str, name: str) -> str:
        return g("MatMul", x, g.constant(np.ascontiguousarray(parameters[name].T)))

    def norm(x: str, name: str) -> str:
        mean = g("ReduceMean", g("Pow", x, two), axes=[-1])
        root = g("Sqrt", g("Add", mean, epsilon))
        return g("Mul", g("Div", x, root), g.constant(parameters[name]))

    def rotated(x: str) -> str:
        first, second = (
            g("Slice", x, *[g.constant([n]) for n in (begin, end, 3)])
            for begin, end in ((0, width // 2), (width // 2, width))
        )
        half = g("Concat", g("Neg", second), first, axis=3)
        return g("Add", g("Mul", x, cos), g("Mul", half, sin))

    frequencies = THETA ** (-np.arange(0, width, 2) / width)
    place = g("Unsqueeze", g("Cast", "position_ids", to=F32), g.constant([1, 3]))
    angles = g("Mul", place, g.real(np.tile(frequencies, 2)))
    cos, sin = g("Cos", angles), g("Sin", angles)
    zero, one = g.constant(np.int64(0)), g.constant(np.int64(1))
    total = g("Squeeze", g("Slice", g("Shape", "attention_mask"), g.constant([1]), g.constant([2])))
    old = g(
        "Squeeze", g("Slice", g("Shape", "past_key_values.0.key"), g.constant([2]), g.constant([3]))
    )
    seen = g(
        "LessOrEqual",
        g("Unsqueeze", g("Range", zero, total, one), g.constant([0])),
        g("Unsqueeze", g("Range", old, total, one), g.constant([1])),
    )
    mask = g("Where", seen, g.real(0.0), g.real(-1e4))
    split, joined = g.constant([0, 0, size.heads, width]), g.constant([0, 0, size.hidden])
    scale, kept = g.real(width**-0.5), {}
    x = g("Gather", g.constant(parameters["token_embd"]), "input_ids")
    for layer in range(size.layers):
        at = f"blk.{layer}."
        normed = norm(x, f"{at}attn_norm")
        q, k, v = (
            g(
                "Transpose",
                g("Reshape", product(normed, f"{at}attn_{n}"), split),
                perm=[0, 2, 1, 3],
            )
            for n in "qkv"
        )
        q, k = rotated(q), rotated(k)
        k = g("Concat", f"past_key_values.{layer}.key", k, axis=2, out=f"present.{layer}.key")
        v = g("Concat", f"past_key_values.{layer}.value", v, axis=2, out=f"present.{layer}.value")
        scores = g("Mul", g("MatMul", q, g("Transpose", k, perm=[0, 1, 3, 2])), scale)
        mixed = g("MatMul", g("Softmax", g("Add", scores, mask), axis=-1), v)
        mixed = g("Reshape", g("Transpose", mixed, perm=[0, 2, 1, 3]), joined)
        x = g("Add", x, product(mixed, f"{at}attn_output"))
        inner = norm(x, f"{at}ffn_norm")
        gate = product(inner, f"{at}ffn_gate")
        gate = g("Mul", g("Mul", gate, g("Sigmoid", gate)), product(inner, f"{at}ffn_up"))
        x = g("Add", x, product(gate, f"{at}ffn_down"))
        for kind in ("key", "value"):
            kept[f"{layer}.{kind}"] = (F32, ["b", size.heads, "p", width])
    last = g(
        "Slice", norm(x, "output_norm"), g.constant([-1]), g.constant([1 << 30]), g.constant([1])
    )
    g("MatMul", last, g.constant(np.ascontiguousarray(parameters["output"].T)), out="logits")
    rank = {name: (I64, ["b", n]) for name, n in
            (("input_ids", "n"), ("attention_mask", "t"), ("position_ids", "n"))}  # fmt: skip
    pasts = {f"past_key_values.{name}": value for name, value in kept.items()}
    presents = {f"present.{name}": (F32, ["b", size.heads, "t", width]) for name in kept}
    return g.model({**rank, **pasts}, {"logits": (F32, ["b", 1, size.tokens]), **presents})


def write_gguf(path: Path, size: LlamaSize, parameters: dict[str, np.ndarray], kind: str) -> None:
    """Write the same model for llama.cpp (F32, Q8_0 or Q4_0 matrices), with made-up tokens."""
    import gguf

    writer = gguf.GGUFWriter(path, "llama")
    writer.add_context_length(CONTEXT)
    writer.add_embedding_length(size.hidden)
    writer.add_block_count(size.layers)
    writer.add_feed_forward_length(size.inner)
    writer.add_head_count(size.heads)
    writer.add_head_count_kv(size.heads)
    writer.add_layer_norm_rms_eps(EPSILON)
    writer.add_rope_dimension_count(size.hidden // size.heads)
    writer.add_rope_freq_base(THETA)
    writer.add_vocab_size(size.tokens)
    first = (*_SPECIAL, *_BYTES)
    texts = [*first, *(f"t{i}" for i in range(len(first), size.tokens))]
    kinds = [_UNKNOWN, _CONTROL, _CONTROL] + [_BYTE] * 256 + [_NORMAL] * (size.tokens - len(first))
    writer.add_tokenizer_model("llama")
    writer.add_token_list(texts)
    writer.add_token_scores([0.0] * size.tokens)
    writer.add_token_types(kinds)
    writer.add_bos_token_id(1)
    writer.add_eos_token_id(2)
    writer.add_unk_token_id(0)
    kept = gguf.GGMLQuantizationType[kind]
    for name, array in parameters.items():
        if name.endswith(("attn_q", "attn_k")):
            array = _interleaved(array, size.heads)
        data = array if array.ndim == 1 else gguf.quants.quantize(array, kept)
        raw = gguf.GGMLQuantizationType.F32 if array.ndim == 1 else kept
        writer.add_tensor(f"{name}.weight", data, raw_dtype=raw)
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()


def _interleaved(array: np.ndarray, heads: int) -> np.ndarray:
    """Reorder rows for the rotary embedding of llama.cpp, which rotates neighbouring rows."""
    rows, columns = array.shape
    halves = array.reshape(heads, 2, rows // heads // 2, columns)
    return np.ascontiguousarray(halves.swapaxes(1, 2).reshape(rows, columns))
