"""Texts, chats and pictures become the tokens that `transformers` makes of them, by the same files.

Tokenizers are cut as those of the families are, and trained on the questions; templates are those
of the families.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed (extra `transformers`)")
pytest.importorskip("transformers", reason="transformers is not installed (extra `transformers`)")

import transformers
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tiny_vlm import IMAGE_TOKEN, SMOLVLM, SPECIAL, pin, publish, train_tokenizer
from tokenizers import Regex, normalizers, pre_tokenizers

from edge.host import resources
from edge.perception.scoring.choice.question import SYSTEM, direction_question
from edge.perception.scoring.vlm.files import read_files
from edge.perception.scoring.vlm.pictures import make_prepare
from edge.perception.scoring.vlm.prompt import Prompter

pytestmark = [pytest.mark.export, pytest.mark.timeout(300)]

QWEN2_VL = (
    "{% set image_count = namespace(value=0) %}{% for message in messages %}{% if loop.first and "
    "message['role'] != 'system' %}<|im_start|>system\nYou are a helpful assistant.<|im_end|>\n"
    "{% endif %}<|im_start|>{{ message['role'] }}\n{% if message['content'] is string %}"
    "{{ message['content'] }}<|im_end|>\n{% else %}{% for content in message['content'] %}"
    "{% if content['type'] == 'image' or 'image' in content or 'image_url' in content %}"
    "{% set image_count.value = image_count.value + 1 %}{% if add_vision_id %}Picture "
    "{{ image_count.value }}: {% endif %}<|vision_start|><|image_pad|><|vision_end|>"
    "{% elif 'text' in content %}{{ content['text'] }}{% endif %}{% endfor %}<|im_end|>\n"
    "{% endif %}{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}"
)
SMOLLM2 = (
    "{% for message in messages %}{% if loop.first and messages[0]['role'] != 'system' %}"
    "{{ '<|im_start|>system\nYou are a helpful AI assistant named SmolLM<|im_end|>\n' }}"
    "{% endif %}{{'<|im_start|>' + message['role'] + '\n' + message['content'] + '<|im_end|>' + "
    "'\n'}}{% endfor %}{% if add_generation_prompt %}{{ '<|im_start|>assistant\n' }}{% endif %}"
)
LAID_OUT = """
{%- for message in messages %}
    {%- if message.role == 'system' %}
{{ bos_token }}{{ message.content[0].text }}
        {%- continue %}
    {%- endif %}
    {# whitespace, loop controls and filters, as newer templates have them #}
    {%- for part in message.content %}
        {%- if part.type == 'image' %}<|vision_start|><|image_pad|><|vision_end|>
        {%- else %}{{ part.text | trim }} {{ {'é': [1, '<']} | tojson }}
        {%- endif %}
    {%- endfor %}
{%- endfor %}
{%- if add_generation_prompt %}
[assistant]{% endif %}
"""
QWEN2_WORDS = (
    r"(?i:'s|'t|'re|'ve|'m|'ll|'d)|[^\r\n\p{L}\p{N}]?\p{L}+|\p{N}| ?[^\s\p{L}\p{N}]+[\r\n]*|"
    r"\s*[\r\n]+|\s+(?!\S)|\s+"
)
BYTES = pre_tokenizers.ByteLevel(add_prefix_space=False)
CUT = {
    "smolvlm": (None, [pre_tokenizers.Digits(individual_digits=True), BYTES]),
    "qwen2-vl": (
        normalizers.NFC(),
        [
            pre_tokenizers.Split(Regex(QWEN2_WORDS), "isolated"),
            pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False),
        ],
    ),
}
CUT["text"] = CUT["smolvlm"]
"""Normalizer and pre-tokenizers by family."""
CLASS = {"smolvlm": "GPT2Tokenizer", "qwen2-vl": "Qwen2Tokenizer", "text": "GPT2Tokenizer"}
LAYOUTS = {
    "smolvlm": ("smolvlm", SMOLVLM),
    "qwen2-vl": ("qwen2-vl", QWEN2_VL),
    "laid out": ("qwen2-vl", LAID_OUT),
    "smollm2": ("text", SMOLLM2),
}
WORDS = st.text(st.characters(exclude_categories=["Cs"]), max_size=60) | st.lists(
    st.sampled_from(
        ["bed", " the", "A", " No", "\n", "\n\n", "  ", "1234", "²", "ß", "é", "é", "東", "🛏️",
         "<image>", "<|image_pad|>", "<|im_start|>", "<row_1_col_2>", "<|im_end|> ", "'ll", "\t"]
    ),
    max_size=12,
).map("".join)  # fmt: skip


class Both:
    """A folder as it is published, read by us and by `transformers`."""

    def __init__(self, layout: str) -> None:
        self.family, template = LAYOUTS[layout]
        special = [*SPECIAL[self.family], *(["<|im_start|>", "<|im_end|>"] * (layout == "smollm2"))]
        card = publish(resources.models_dir(), self.family, layout.replace(" ", "-"), pinned=False)
        made = train_tokenizer(special)
        normalizer, cuts = CUT[self.family]
        if normalizer is not None:
            made.normalizer = normalizer
        made.pre_tokenizer = pre_tokenizers.Sequence(cuts)
        made.save(str(card.path / "tokenizer.json"))
        self._change(
            card.path / "tokenizer_config.json", tokenizer_class=CLASS[self.family],
            bos_token={"__type": "AddedToken", "content": special[0]}, eos_token=special[-1],
        )  # fmt: skip
        if self.family in IMAGE_TOKEN:
            image = made.token_to_id(IMAGE_TOKEN[self.family])
            self._change(card.path / "config.json", image_token_id=image)
        template_of = {"chat_template": template}
        own = card.path / "chat_template.json"
        self._change(own if own.exists() else card.path / "tokenizer_config.json", **template_of)
        pin(card)
        self.files = read_files(card)
        self.ours = Prompter(self.files)
        self.theirs = transformers.AutoTokenizer.from_pretrained(card.path, local_files_only=True)
        self.theirs.chat_template = template
        self.card = card

    @staticmethod
    def _change(path: Path, **changes: object) -> None:
        path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))

    def rendered(self, rules: str, view: str | None, question: str) -> str:
        """By `transformers`."""
        if self.files.image is None:
            system, user = rules, f"{view}\n{question}"
        else:
            system = [{"type": "text", "text": rules}]
            seen = {"type": "image"} if view is None else {"type": "text", "text": view}
            user = [seen, {"type": "text", "text": question}]
        messages = [{"role": "system", "content": system}, {"role": "user", "content": user}]
        return self.theirs.apply_chat_template(messages, tokenize=False, add_generation_prompt=True)


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """Each layout, read once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGE_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        resources.models_dir().mkdir(parents=True)
        yield {layout: Both(layout) for layout in LAYOUTS}


@pytest.mark.parametrize("layout", LAYOUTS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=WORDS)
def test_a_text_is_the_same_tokens(both, layout, text):
    one = both[layout]
    wanted = one.theirs(text, add_special_tokens=False)["input_ids"]
    assert one.ours.ids(text).tolist() == wanted


@pytest.mark.parametrize("layout", LAYOUTS)
def test_empty_text_gives_no_tokens(both, layout):
    one = both[layout]
    assert one.ours.ids("").dtype == np.int64
    assert one.ours.ids("").tolist() == one.theirs("", add_special_tokens=False)["input_ids"] == []


@pytest.mark.parametrize("layout", LAYOUTS)
def test_special_tokens_are_single_tokens(both, layout):
    one = both[layout]
    for special in SPECIAL[one.family]:
        (token,) = one.ours.ids(special)
        assert token == one.theirs.convert_tokens_to_ids(special)


@pytest.mark.parametrize("layout", LAYOUTS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    target=st.sampled_from(["bed", "tall white trash can", "Kühlschrank", "a\nb", "{{ x }}"]),
    marks=st.integers(1, 8),
    view=st.none() | st.sampled_from(["- bed, left, 2.1 m", "ß"]),
)
def test_a_chat_is_the_same_text(both, layout, target, marks, view):
    one, question = both[layout], direction_question(marks, target)
    if one.files.image is None:
        view = view or "The robot sees nothing."
    wanted = one.rendered(SYSTEM, view, question)
    assert one.ours.text(SYSTEM, view, question) == wanted
    assert (
        one.ours.ids(wanted).tolist() == one.theirs(wanted, add_special_tokens=False)["input_ids"]
    )


@pytest.mark.parametrize("hw", [(32, 32), (48, 64), (64, 48), (30, 100), (96, 128)])
@pytest.mark.parametrize("layout", ["smolvlm", "qwen2-vl"])
def test_a_picture_is_the_same_tokens_and_numbers(both, layout, hw):
    """Compare the image tokens and the pixels with the families' processors."""
    one, question = both[layout], direction_question(3, "bed")
    rgb = np.random.default_rng(0).integers(0, 256, (*hw, 3), np.uint8)
    picture = make_prepare(one.files, one.ours.image_token, one.card.image_tokens)(rgb)
    text = one.ours.text(SYSTEM, None, question)
    ids = one.ours.ids(text.replace(one.ours.image_token, picture.text))
    wanted = processed(one, rgb, one.rendered(SYSTEM, None, question))
    assert ids.tolist() == np.ravel(wanted["input_ids"]).tolist()
    found = picture.feeds["pixel_values"]
    np.testing.assert_allclose(found, wanted["pixel_values"], atol=2e-2, err_msg="pixels")
    assert np.abs(found - wanted["pixel_values"]).mean() < 1e-3
    if "image_grid_thw" in wanted:
        assert picture.feeds["grid_thw"].tolist() == np.asarray(wanted["image_grid_thw"]).tolist()


def processed(one: Both, rgb: np.ndarray, text: str) -> dict[str, np.ndarray]:
    """Return a processor's tensors for an image and a text about it."""
    prefix = {"smolvlm": "Idefics3", "qwen2-vl": "Qwen2VL"}[one.family]
    images = getattr(transformers, f"{prefix}ImageProcessorPil").from_pretrained(
        one.card.path, local_files_only=True
    )
    kind = getattr(transformers, f"{prefix}Processor")
    more = one.files.processor if one.family == "smolvlm" else {"video_processor": None}
    with pytest.MonkeyPatch.context() as patch:  # its video processor would need torchvision
        patch.setattr(transformers.ProcessorMixin, "check_argument_for_proper_class", lambda *_: "")
        processor = kind(image_processor=images, tokenizer=one.theirs, **more)
    return processor(text=[text], images=[rgb], return_tensors="np", add_special_tokens=False)
