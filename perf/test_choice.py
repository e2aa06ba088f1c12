"""Benchmark: time that cached prompt prefixes save a model that chooses directions."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
import pytest

from edge.host import resources
from edge.perception.scoring.choice.letter_scorer import both_questions
from edge.perception.scoring.choice.question import (
    SYSTEM,
    DetectedObject,
    Mark,
    MarkedView,
    describe,
)
from edge.perception.scoring.vlm.model import LanguageModel
from edge.types import Observation
from exporters.weight_only import quantize_weights

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from small_llama import LlamaSize, onnx_of, weights, write_gguf
from tiny_vlm import Size, pin, publish

LIMIT_S = 600.0
MOST_TOKENS = 2048  # of a prompt
SIZE = Size(hidden=256, heads=4, layers=8)
LLAMA = LlamaSize(*SIZE, inner=704, tokens=600)


def view(k: int) -> str:
    """Return the description of view number `k` in words; each number gives another one."""
    seen = tuple(DetectedObject(f"thing {k + i}", 0.1 * i, 1.0 + i) for i in range(8))
    marks = tuple(Mark(i, 0.0, 0.0, 0.3 * i, 2.0 + i) for i in range(4))
    return describe(MarkedView(Observation(0, 0, np.eye(4)), "chair", marks, seen))


def test_two_questions_against_two_prefills(benchmark, against, tmp_path, monkeypatch):
    """Compare both questions about a new view with two full prefills, in processor time.

    The reference reads both questions completely, in its own session without a cache.
    """
    benchmark.extra_info["budget"] = "choice_two_questions"
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    card = publish(resources.models_dir(), "text", size=SIZE)
    questions, views = both_questions(4, "chair"), iter(range(1 << 30))
    model = LanguageModel(card, both_questions(8, "chair"), threads=1)
    found = benchmark.pedantic(
        lambda: model.ask(SYSTEM, view(next(views)), questions, LIMIT_S), rounds=15, warmup_rounds=2
    )
    assert found[0].sum() > 0.99

    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(str(card.path_of(card.decoder)), options)
    nothing = model._decoder.nothing.arrays

    def read_whole() -> None:
        words = view(next(views))
        for asked in questions:
            ids = model._prompter.ids(model._prompter.text(SYSTEM, words, asked.question))
            places = np.arange(len(ids))[None]
            feeds = {"input_ids": ids[None], "attention_mask": np.ones_like(places)}
            session.run(["logits"], {**feeds, "position_ids": places, **nothing})

    against(read_whole)


def test_prefill_against_genai(benchmark, against, tmp_path, monkeypatch):
    """Compare the prefill of 200 tokens with onnxruntime-genai on the same file.

    30 tokens follow the prefix that both questions share. Both must give the same answer.
    """
    genai = pytest.importorskip("onnxruntime_genai", reason="pip install onnxruntime-genai")
    benchmark.extra_info["budget"] = "choice_prefill_200"
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    card = publish(resources.models_dir(), "text", size=SIZE)
    model = LanguageModel(card, both_questions(8, "chair"), threads=1)
    tokens = model._prompter.tokenizer.get_vocab_size()
    ids = np.random.default_rng(0).integers(0, tokens, 200)
    ours = prefill_of(model, ids)

    (card.path / "genai_config.json").write_text(json.dumps(genai_config(tokens)))
    theirs = genai.Model(str(card.path))
    parameters = genai.GeneratorParams(theirs)
    parameters.set_search_options(max_length=MOST_TOKENS)

    def peer() -> np.ndarray:
        generator = genai.Generator(theirs, parameters)
        generator.append_tokens(ids.astype(np.int32))
        return np.asarray(generator.get_logits()).reshape(-1, tokens)[-1]

    np.testing.assert_allclose(ours(), peer(), atol=1e-4)
    benchmark.pedantic(ours, rounds=15, warmup_rounds=2)
    against(peer)


@pytest.mark.parametrize(
    ("kind", "precision", "differ"),
    [("F32", "fp32", 5e-3), ("Q8_0", "int8", 0.4), ("Q4_0", "q4", 1.2)],
)
def test_prefill_against_llama_cpp(
    benchmark, against, tmp_path, monkeypatch, kind, precision, differ
):
    """Compare the prefill of 200 tokens with llama.cpp, which reads all tokens in one go.

    Both run a Llama with the same weights. With fewer bits they round differently: `differ` is the
    largest difference of a log-probability.
    """
    llama = pytest.importorskip("xllamacpp", reason="pip install xllamacpp")
    pytest.importorskip("gguf", reason="pip install gguf")
    benchmark.extra_info["budget"] = f"choice_prefill_200_llama_{kind.lower()}"
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    parameters = weights(LLAMA)
    card = publish(resources.models_dir(), "text", size=SIZE)
    network = onnx_of(LLAMA, parameters)
    if precision != "fp32":
        network = quantize_weights(network, precision)
    onnx.save(network, card.path_of(card.decoder))
    pin(card)
    model = LanguageModel(card, both_questions(8, "chair"), threads=1)
    ids = np.random.default_rng(0).integers(0, LLAMA.tokens, 200)
    ours = prefill_of(model, ids)

    write_gguf(tmp_path / "llama.gguf", LLAMA, parameters, kind)
    theirs = llama.Server(llama_params(llama, tmp_path / "llama.gguf"))
    question = {
        "prompt": ids.tolist(), "max_tokens": 1, "cache_prompt": False, "temperature": 0.0,
        "logprobs": 1,
    }  # fmt: skip

    def peer(**more: object) -> dict:
        return theirs.handle_completions({**question, **more})

    answer = peer(n_probs=LLAMA.tokens)
    assert answer["timings"]["prompt_n"] == 200
    likeliest = answer["choices"][0]["logprobs"]["content"][0]["top_logprobs"]
    by_id = sorted(likeliest, key=lambda token: token["id"])
    logprobs = np.array([token["logprob"] for token in by_id])
    logits = ours()
    np.testing.assert_allclose(logits - np.logaddexp.reduce(logits), logprobs, atol=differ)
    benchmark.pedantic(ours, rounds=15, warmup_rounds=2)
    against(peer, time.process_time)  # it reads on a thread of its own


def prefill_of(model: LanguageModel, ids: np.ndarray) -> Callable[[], np.ndarray]:
    """Return a function that reads all but the last 30 tokens, and then these 30."""
    decoder, places = model._decoder, np.tile(np.arange(len(ids)), (3, 1))

    def prefill() -> np.ndarray:
        with model._deadline.within(LIMIT_S):
            past = decoder.read(ids[:-30], places[:, :-30], decoder.nothing)
            return decoder.next_logits(ids[-30:], places[:, -30:], past)

    return prefill


def llama_params(llama: Any, path: Path) -> Any:
    """Return parameters for one thread on the CPU, without a cache between questions."""
    parameters = llama.CommonParams()
    parameters.model.path, parameters.n_ctx, parameters.n_parallel = str(path), MOST_TOKENS, 1
    parameters.cpuparams.n_threads = parameters.cpuparams_batch.n_threads = 1
    parameters.cache_type_k = parameters.cache_type_v = llama.ggml_type.GGML_TYPE_F32
    parameters.cache_ram_mib, parameters.n_gpu_layers, parameters.port, parameters.verbosity = (
        0,
        0,
        0,
        0,
    )
    return parameters


def genai_config(tokens: int) -> dict:
    """Return the model's configuration for onnxruntime-genai."""
    inputs = {name: name for name in ("input_ids", "attention_mask", "position_ids")}
    for kind in ("key", "value"):
        inputs[f"past_{kind}_names"] = f"past_key_values.%d.{kind}"
    outputs = {f"present_{kind}_names": f"present.%d.{kind}" for kind in ("key", "value")}
    decoder = {
        "filename": "onnx/decoder_model_merged.onnx",
        "hidden_size": SIZE.hidden,
        "head_size": SIZE.hidden // SIZE.heads,
        "num_attention_heads": SIZE.heads,
        "num_key_value_heads": SIZE.heads,
        "num_hidden_layers": SIZE.layers,
        "session_options": {"intra_op_num_threads": 1, "provider_options": []},
        "inputs": inputs,
        "outputs": {"logits": "logits", **outputs},
    }
    ends = {"bos_token_id": 0, "eos_token_id": 0, "pad_token_id": 0}
    model = {"type": "llama", "vocab_size": tokens, "context_length": MOST_TOKENS, **ends}
    return {
        "model": {**model, "decoder": decoder},
        "search": {"max_length": MOST_TOKENS, "past_present_share_buffer": False},
    }
