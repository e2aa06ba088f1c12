"""Language models with the files, inputs and outputs of published ones, random and tiny.

The decoder is a real one (causal attention over a past, places of tokens in one number or three),
so that what was read before must be told it rightly; the tokenizer is byte-pair encoding, trained
on the questions; the chat templates are written in the style of the families'.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from onnx import TensorProto, helper, numpy_helper, save
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, trainers

from edge.perception.runtime.card_types import ChoiceCard
from edge.perception.scoring.choice.question import DIRECTION, SCENE, SYSTEM

SIDE = 32


class Size(NamedTuple):
    hidden: int
    heads: int
    layers: int


TINY = Size(16, 2, 2)
HIDDEN = TINY.hidden
F32, F16, I64, BOOL = TensorProto.FLOAT, TensorProto.FLOAT16, TensorProto.INT64, TensorProto.BOOL

SMOLVLM = (
    "<|im_start|>{% for message in messages %}{{message['role'] | capitalize}}"
    "{% if message['content'][0]['type'] == 'image' %}{{':'}}{% else %}{{': '}}{% endif %}"
    "{% for line in message['content'] %}{% if line['type'] == 'text' %}{{line['text']}}"
    "{% elif line['type'] == 'image' %}{{ '<image>' }}{% endif %}{% endfor %}<end_of_utterance>\n"
    "{% endfor %}{% if add_generation_prompt %}{{ 'Assistant:' }}{% endif %}"
)
QWEN = (
    "{% for message in messages %}<|im_start|>{{ message.role }}\n"
    "{% if message.content is string %}{{ message.content }}{% else %}"
    "{% for part in message.content %}{% if part.type == 'image' %}"
    "<|vision_start|><|image_pad|><|vision_end|>{% else %}{{ part.text }}{% endif %}{% endfor %}"
    "{% endif %}<|im_end|>\n{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n"
    "{% endif %}"
)
PLAIN = (
    "{{ bos_token }}{% for message in messages %}[{{ message['role'] }}] {{ message['content'] }}\n"
    "{% endfor %}{% if add_generation_prompt %}[assistant]{% endif %}"
)
SPECIAL = {
    "smolvlm": [
        "<|im_start|>", "<end_of_utterance>", "<image>", "<fake_token_around_image>",
        "<global-img>", *(f"<row_{r}_col_{c}>" for r in range(1, 5) for c in range(1, 5)),
    ],
    "qwen2-vl": [
        "<|im_start|>", "<|im_end|>", "<|vision_start|>", "<|image_pad|>", "<|vision_end|>",
    ],
    "text": ["<s>"],
}  # fmt: skip
IMAGE_TOKEN = {"smolvlm": "<image>", "qwen2-vl": "<|image_pad|>"}
PREPROCESSOR = {
    "smolvlm": {
        "image_processor_type": "Idefics3ImageProcessor", "do_image_splitting": True,
        "size": {"longest_edge": 4 * SIDE}, "max_image_size": {"longest_edge": SIDE},
        "resample": 1, "rescale_factor": 1 / 255, "image_mean": [0.5] * 3, "image_std": [0.5] * 3,
    },
    "qwen2-vl": {
        "image_processor_type": "Qwen2VLImageProcessor", "patch_size": 4, "merge_size": 2,
        "temporal_patch_size": 2, "min_pixels": 64, "max_pixels": 6400,
        "image_mean": [0.48, 0.46, 0.41], "image_std": [0.27, 0.26, 0.28],
    },
}  # fmt: skip
TEMPLATE = {"smolvlm": SMOLVLM, "qwen2-vl": QWEN, "text": PLAIN}


def publish(
    models_dir: Path,
    family: str,
    name: str = "tiny",
    half: bool = False,
    pinned: bool = True,
    size: Size = TINY,
) -> ChoiceCard:
    """Write a model of a family as it is published, and its card; the card."""
    folder = models_dir / f"{name}-files"
    (folder / "onnx").mkdir(parents=True)
    tokenizer = train_tokenizer(SPECIAL[family])
    tokenizer.save(str(folder / "tokenizer.json"))
    sees = family in IMAGE_TOKEN
    config: dict = {"num_attention_heads": size.heads, "hidden_size": size.hidden}
    if sees:
        image_id = tokenizer.token_to_id(IMAGE_TOKEN[family])
        config = {"text_config": config, "image_token_id": image_id}
    others = {
        "config.json": config,
        "tokenizer_config.json": {"bos_token": {"content": "<s>"}, "eos_token": "</s>"},
    }
    if family == "smolvlm":
        others["processor_config.json"] = {"image_seq_len": 4}
        others["chat_template.json"] = {"chat_template": TEMPLATE[family]}
    else:
        others["tokenizer_config.json"]["chat_template"] = TEMPLATE[family]
    if sees:
        others["preprocessor_config.json"] = PREPROCESSOR[family]
    for file, content in others.items():
        (folder / file).write_text(json.dumps(content))
    vocabulary, rng = tokenizer.get_vocab_size(), np.random.default_rng(0)
    dtype = F16 if half else F32
    networks = {"decoder": ("decoder_model_merged", decoder(vocabulary, rng, family, dtype, size))}
    if sees:
        networks["embed_tokens"] = ("embed_tokens", embedding(vocabulary, rng, dtype))
        make = {"smolvlm": idefics3_encoder, "qwen2-vl": qwen2_vl_encoder}[family]
        networks["vision_encoder"] = ("vision_encoder", make(rng, dtype))
    for file, network in networks.values():
        save(network, str(folder / "onnx" / f"{file}.onnx"))
    parts = {key: {"file": f"onnx/{file}.onnx"} for key, (file, _) in networks.items()}
    said = {
        "name": name, "task": "choice", "family": family, "license": "Apache-2.0",
        "precision": "fp16" if half else "fp32", "folder": folder.name, "image_tokens": 100,
        **parts,
        "others": [{"file": file} for file in ("tokenizer.json", *others)],
    }  # fmt: skip
    (models_dir / f"{name}.yaml").write_text(yaml.safe_dump(said))
    card = ChoiceCard.model_validate(said)
    if pinned:
        pin(card)
    return card


def pin(card: ChoiceCard) -> None:
    """Write the hash of each file next to it, as the first pull does."""
    from edge.perception.runtime.model_file import sha256_of

    for part in card.parts:
        path = card.path_of(part)
        told = {"sha256": sha256_of(path), "bytes": path.stat().st_size}
        path.with_name(path.name + ".json").write_text(json.dumps(told))


def train_tokenizer(special: list[str], letters: str = "ABCDEFGHJ") -> Tokenizer:
    """Byte-pair encoding in which the letters, Yes and No are one token, behind a space or not."""
    tokenizer = Tokenizer(models.BPE())
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    alphabet = [c for c in pre_tokenizers.ByteLevel.alphabet() if c in letters or not c.isupper()]
    trainer = trainers.BpeTrainer(
        vocab_size=600, special_tokens=special, initial_alphabet=alphabet, show_progress=False
    )
    words = [f"{a} {b}" for a in (*letters, "Yes", "No") for b in (*letters, "Yes", "No")]
    text = [SYSTEM, DIRECTION, SCENE, *words * 3]
    tokenizer.train_from_iterator(text if set("ABC") <= set(letters) else words, trainer)
    return tokenizer


# -- networks ---------------------------------------------------------------------------------


class Graph:
    """Builder of nodes and weights; each method returns the name of its output."""

    def __init__(self, rng: np.random.Generator, dtype: int) -> None:
        self.rng, self.dtype = rng, dtype
        self.nodes, self.weights, self.count = [], [], 0

    def __call__(self, op: str, *inputs: str, out: str | None = None, **attributes) -> str:
        self.count += 1
        out = out or f"v{self.count}"
        self.nodes.append(helper.make_node(op, list(inputs), [out], **attributes))
        return out

    def constant(self, array) -> str:
        self.count += 1
        name = f"c{self.count}"
        self.weights.append(numpy_helper.from_array(np.asarray(array), name))
        return name

    def real(self, array) -> str:
        return self.constant(np.asarray(array, helper.tensor_dtype_to_np_dtype(self.dtype)))

    def random(self, *shape: int, scale: float = 0.5) -> str:
        return self.real(self.rng.normal(0.0, scale, shape))

    def model(self, inputs: dict, outputs: dict):
        ends = [
            [helper.make_tensor_value_info(name, *what) for name, what in some.items()]
            for some in (inputs, outputs)
        ]
        graph = helper.make_graph(self.nodes, "g", *ends, self.weights)
        opset = [helper.make_opsetid("", 17)]
        return helper.make_model(graph, opset_imports=opset, ir_version=8)


def embedding(vocabulary: int, rng: np.random.Generator, dtype: int):
    g = Graph(rng, dtype)
    g("Gather", g.random(vocabulary, HIDDEN), "input_ids", out="inputs_embeds")
    return g.model({"input_ids": (I64, ["b", "n"])}, {"inputs_embeds": (dtype, ["b", "n", HIDDEN])})


def decoder(vocabulary: int, rng: np.random.Generator, family: str, dtype: int, size: Size = TINY):
    """Attention over past and present with a causal mask; the text family embeds tokens itself."""
    hidden, heads, layers = size
    g, width = Graph(rng, dtype), hidden // heads
    axes = 3 if family == "qwen2-vl" else 1
    if family == "text":
        x, first = g("Gather", g.random(vocabulary, hidden), "input_ids"), ("input_ids", I64, [])
    else:
        x, first = "inputs_embeds", ("inputs_embeds", dtype, [hidden])
    places = "position_ids"
    if axes == 1:
        places = g("Unsqueeze", places, g.constant(np.array([0])))
    angles = g(
        "MatMul",
        g("Cast", g("Transpose", places, perm=[1, 2, 0]), to=dtype),
        g.real(rng.uniform(0.05, 0.5, (axes, hidden))),
    )
    x = g("Add", x, g("Sin", angles))
    one, zero = g.constant(np.int64(1)), g.constant(np.int64(0))
    total = g(
        "Squeeze", g("Slice", g("Shape", "attention_mask"), *[g.constant([i]) for i in (1, 2)])
    )
    old = g(
        "Squeeze",
        g("Slice", g("Shape", "past_key_values.0.key"), *[g.constant([i]) for i in (2, 3)]),
    )
    seen = g(
        "LessOrEqual",
        g("Unsqueeze", g("Range", zero, total, one), g.constant([0])),
        g("Unsqueeze", g("Range", old, total, one), g.constant([1])),
    )
    mask = g("Where", seen, g.real(0.0), g.real(-1e4))
    shape = g.constant([0, 0, heads, width])
    presents = {}

    def weights() -> str:
        return g.random(hidden, hidden, scale=2 / hidden**0.5)

    for layer in range(layers):
        q, k, v = (
            g("Transpose", g("Reshape", g("MatMul", x, weights()), shape), perm=[0, 2, 1, 3])
            for _ in range(3)
        )
        k = g("Concat", f"past_key_values.{layer}.key", k, axis=2, out=f"present.{layer}.key")
        v = g("Concat", f"past_key_values.{layer}.value", v, axis=2, out=f"present.{layer}.value")
        scores = g("Add", g("MatMul", q, g("Transpose", k, perm=[0, 1, 3, 2])), mask)
        heard = g("MatMul", g("Softmax", scores, axis=-1), v)
        heard = g("Reshape", g("Transpose", heard, perm=[0, 2, 1, 3]), g.constant([0, 0, hidden]))
        x = g("Add", x, g("Tanh", g("MatMul", heard, weights())))
        for kind in ("key", "value"):
            presents[f"{layer}.{kind}"] = (dtype, ["b", heads, "m", width])
    g("MatMul", x, g.random(hidden, vocabulary), out="logits")
    rank = ["b", "n"] if axes == 1 else [3, "b", "n"]
    inputs = {
        first[0]: (first[1], ["b", "n", *first[2]]),
        "attention_mask": (I64, ["b", "t"]),
        "position_ids": (I64, rank),
        **{f"past_key_values.{k}": (v[0], ["b", heads, "p", width]) for k, v in presents.items()},
    }
    outputs = {
        "logits": (dtype, ["b", "n", vocabulary]),
        **{f"present.{k}": v for k, v in presents.items()},
    }
    return g.model(inputs, outputs)


def idefics3_encoder(rng: np.random.Generator, dtype: int):
    """(1, images, 3, side, side) and its mask → (images, 4, hidden)."""
    g = Graph(rng, F32)
    images = g("Reshape", "pixel_values", g.constant([-1, 3, SIDE, SIDE]))
    half = SIDE // 2
    conv = g(
        "Conv", images, g.random(HIDDEN, 3, half, half, scale=0.05),
        kernel_shape=[half, half], strides=[half, half],
    )  # fmt: skip
    rows = g("Transpose", g("Reshape", conv, g.constant([0, HIDDEN, 4])), perm=[0, 2, 1])
    there = g("Cast", "pixel_attention_mask", to=F32)
    share = g("Reshape", g("ReduceMean", there, axes=[2, 3], keepdims=0), g.constant([-1, 1, 1]))
    g("Mul", rows, share, out="image_features")
    return g.model(
        {
            "pixel_values": (F32, ["b", "i", 3, SIDE, SIDE]),
            "pixel_attention_mask": (BOOL, ["b", "i", SIDE, SIDE]),
        },
        {"image_features": (F32, ["i", 4, HIDDEN])},
    )


def qwen2_vl_encoder(rng: np.random.Generator, dtype: int):
    """(n, 96) patches → (n / 4, hidden); it adds a little of its grid."""
    g = Graph(rng, F32)
    merged = g("Reshape", "pixel_values", g.constant([-1, 4 * 96]))
    rows = g("MatMul", merged, g.random(4 * 96, HIDDEN, scale=0.05))
    grid = g("ReduceMean", g("Cast", "grid_thw", to=F32), keepdims=0)
    g("Add", rows, g("Mul", grid, g.real(0.01)), out="image_features")
    return g.model(
        {"pixel_values": (F32, ["n", 96]), "grid_thw": (I64, ["i", 3])},
        {"image_features": (F32, ["m", HIDDEN])},
    )
