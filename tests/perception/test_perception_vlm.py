"""Published language models: their inputs, their answers and their failures."""

from __future__ import annotations

import json
import math
import threading

import numpy as np
import pytest
import tiny_vlm
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, load, parser, save
from patience import PATIENCE_S, eventually
from tiny_vlm import F32, HIDDEN, SIDE, Graph, pin, publish, train_tokenizer

from edge.config import PerceptionConfig
from edge.host import resources
from edge.perception.runtime.cards import ModelError, load_card
from edge.perception.scoring.choice.factory import make_view_scorer
from edge.perception.scoring.choice.letter_scorer import both_questions
from edge.perception.scoring.choice.question import SYSTEM, DetectedObject, Mark, MarkedView
from edge.perception.scoring.vlm.answers import (
    answer_probabilities,
    answer_token_ids,
    probabilities,
)
from edge.perception.scoring.vlm.files import read_files, vocabulary
from edge.perception.scoring.vlm.model import LanguageModel
from edge.perception.scoring.vlm.pictures import make_prepare, positions, smart_resize

FAMILIES = ("text", "smolvlm", "qwen2-vl")
EVERY = both_questions(8, "chair")


@pytest.fixture
def models_dir(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    folder = resources.models_dir()
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def opened(card) -> LanguageModel:
    return LanguageModel(card, EVERY, threads=1)


def a_view(model, seed=0):
    if not model.takes_images:
        return f"The robot sees:\n- bed, left, {seed}.1 m\nIt can go on in these directions:"
    return np.random.default_rng(seed).integers(0, 255, (48, 64, 3), np.uint8)


# -- answers ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tokens", "answers", "expected"),
    [
        ([], "A", [[]]),
        (["A", "B"], "AB", [[0], [1]]),
        (["A", " A", "ĠA", "▁A", "(A", "A."], "A", [[0, 1, 2, 3, 4, 5]]),
        (["a", "An", "AA", "B"], "AB", [[], [3]]),
        (["yes", " Yes", "NO", "No.", "not"], ("Yes", "No"), [[0, 1], [2, 3]]),
    ],
)
def test_an_answer_is_every_token_with_its_text(tokens, answers, expected):
    assert [ids.tolist() for ids in answer_token_ids(tokens, answers)] == expected


@given(st.lists(st.floats(-50, 50, width=32), min_size=5, max_size=5), st.floats(-30, 30))
def test_eq_4_is_a_softmax_over_the_answers_of_servers(logits, shift):
    """Known by all logits or by all log-probabilities, with and without a space before."""
    tokens = ["A", " A", "B", "the", "C"]
    logits = np.array(logits)
    p = answer_probabilities((logits + shift).astype(np.float32), answer_token_ids(tokens, "ABC"))
    assert p.dtype == np.float32
    assert p.sum() == pytest.approx(1.0, abs=1e-5)
    logprobs = logits - np.logaddexp.reduce(logits)
    told = probabilities(list(zip(tokens, logprobs.tolist(), strict=True)), "ABC")
    np.testing.assert_allclose(p, told, atol=1e-4)


# -- reading once -----------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_the_prompt_cache_does_not_change_answers(models_dir, family):
    """Compare with a model without a cache after any other views and questions."""
    card = publish(models_dir, family)
    model = opened(card)
    for seed, n, target in [(0, 2, "lamp"), (1, 2, "lamp"), (1, 8, "bed"), (1, 8, "bed")]:
        view = a_view(model, seed)
        asked = both_questions(n, target)
        found = model.ask(SYSTEM, view, asked, PATIENCE_S)
        for p, one in zip(found, asked, strict=True):
            assert len(p) == len(one.answers)
            assert p.sum() == pytest.approx(1.0, abs=1e-5)
            (alone,) = opened(card).ask(SYSTEM, view, (one,), PATIENCE_S)
            np.testing.assert_allclose(p, alone, atol=1e-5)
    other = model.ask(SYSTEM, a_view(model, 7), asked, PATIENCE_S)
    assert not np.array_equal(found[0], other[0])


# -- pictures ---------------------------------------------------------------------------------


def prepared(models_dir, family, rgb, tokens, **changes):
    card = publish(models_dir, family).model_copy(update={"image_tokens": tokens})
    files = read_files(card)
    files.image.update(changes)
    return make_prepare(files, "<image>", tokens)(rgb)


@pytest.mark.parametrize(
    ("hw", "tokens", "tiles"),
    [
        ((48, 64), 4, 0),  # room for the entire image alone
        ((48, 64), 100, 12),  # 128 × 96 pixels are 4 × 3 tiles of 32
        ((64, 48), 100, 12),
        ((48, 64), 4 * 12, 9),  # those and the entire image are too many: 96 × 72
        ((10, 300), 100, 4),
        ((32, 32), 100, 16),
    ],
)
def test_an_image_becomes_tiles_as_far_as_there_is_room(models_dir, hw, tokens, tiles):
    rgb = np.zeros((*hw, 3), np.uint8)
    rgb[: hw[0] // 2] = 255
    feeds, text, grid = prepared(models_dir, "smolvlm", rgb, tokens)
    n = feeds["pixel_values"].shape[1]
    assert n == tiles + 1
    assert feeds["pixel_values"].shape == (1, n, 3, SIDE, SIDE)
    assert feeds["pixel_values"].dtype == np.float32
    assert feeds["pixel_attention_mask"].shape == (1, n, SIDE, SIDE)
    assert text.count("<image>") == 4 * n
    assert grid is None
    last = feeds["pixel_values"][0, -1]
    assert last[:, 0].min() > 0.9
    assert last[:, -1].max() < -0.9
    if n > 5:  # the first tile is above, the last below
        assert feeds["pixel_values"][0, 0].mean() > feeds["pixel_values"][0, -2].mean()


def test_the_prompt_names_tiles_as_idefics3_was_taught(models_dir):
    marks = "<image>" * 4
    _, text, _ = prepared(models_dir, "smolvlm", np.zeros((10, 64, 3), np.uint8), 12, size={
        "longest_edge": 64
    })  # fmt: skip
    fake = "<fake_token_around_image>"
    assert text == (
        f"{fake}<row_1_col_1>{marks}{fake}<row_1_col_2>{marks}\n\n{fake}<global-img>{marks}{fake}"
    )


def test_patches_are_ordered_by_the_squares_that_are_merged(models_dir):
    """Against loops: (merged row, merged column, row within, column within)."""
    rgb = np.random.default_rng(0).integers(0, 255, (16, 24, 3), np.uint8)
    feeds, text, grid = prepared(models_dir, "qwen2-vl", rgb, 100, max_pixels=16 * 24)
    assert feeds["grid_thw"].tolist() == [[1, 4, 6]]
    assert grid == (1, 2, 3)
    assert text == "<image>" * 6
    mean, std = np.array([0.48, 0.46, 0.41]), np.array([0.27, 0.26, 0.28])
    planes = ((rgb / 255 - mean) / std).transpose(2, 0, 1)
    rows = []
    for i in range(2):
        for j in range(3):
            for a in range(2):
                for b in range(2):
                    y, x = 4 * (2 * i + a), 4 * (2 * j + b)
                    square = planes[:, y : y + 4, x : x + 4]
                    rows.append(np.stack([square, square], axis=1).ravel())
    np.testing.assert_allclose(feeds["pixel_values"], rows, atol=1e-5)


@pytest.mark.parametrize(
    ("hw", "bounds", "expected"),
    [
        ((480, 640), (3136, 1003520), (476, 644)),  # the nearest multiples
        ((480, 640), (3136, 78400), (224, 308)),  # at most 100 tokens
        ((30, 40), (3136, 1003520), (56, 84)),
        ((28, 28), (784, 784), (28, 28)),
        ((1, 300), (784, 1003520), (28, 308)),
        ((2000, 20), (784, 7840), (868, 28)),  # no side is nothing: more than there should be
    ],
)
def test_smart_resize(hw, bounds, expected):
    assert smart_resize(*hw, 28, *bounds) == expected


@pytest.mark.parametrize(
    ("ids", "grid", "expected"),
    [
        ([], None, [[], [], []]),
        ([1, 2, 3], None, [[0, 1, 2]] * 3),
        ([9, 9, 9], None, [[0, 1, 2]] * 3),
        ([1, 9, 9, 2], (1, 1, 2), [[0, 1, 1, 3], [0, 1, 1, 3], [0, 1, 2, 3]]),
        ([9, 9, 9, 9, 9, 9, 5], (1, 3, 2), [
            [0, 0, 0, 0, 0, 0, 3], [0, 0, 1, 1, 2, 2, 3], [0, 1, 0, 1, 0, 1, 3],
        ]),
    ],
)  # fmt: skip
def test_places_of_tokens(ids, grid, expected):
    assert positions(np.array(ids, np.int64), 9, grid).tolist() == expected


# -- a choice ---------------------------------------------------------------------------------


def made(**choice):
    choice = {"kind": "onnx", "threads": 1, **choice}
    perception = PerceptionConfig.model_validate({"detector": {"kind": "sim"}, "choice": choice})
    return make_view_scorer(perception.choice, perception)


def view_of(make_observation, **arrays):
    marks = (Mark(7, 20.0, 40.0, 0.3, 2.0), Mark(9, 60.0, 40.0, -0.3, 4.0))
    return MarkedView(
        make_observation(seq=3, **arrays), "lamp", marks, (DetectedObject("bed", 0.5, 1.0),)
    )


@pytest.mark.parametrize("family", FAMILIES)
def test_a_view_becomes_a_choice(models_dir, make_observation, family):
    card = publish(models_dir, family)
    asks = made(card="tiny", time_limit_s=PATIENCE_S)
    rgb = np.random.default_rng(0).integers(0, 255, (64, 80, 3), np.uint8)
    shown = asks.prepare(view_of(make_observation, rgb=rgb))
    choice = asks.answer(shown)
    assert asks.name == "tiny"
    assert (choice.stamp_ns, choice.target, choice.ids) == (300_000_000, "lamp", (7, 9))
    assert choice.p.sum() + choice.elsewhere == pytest.approx(1.0, abs=1e-5)
    assert 0.0 <= choice.scene <= 1.0
    np.testing.assert_allclose(choice.value, choice.scene * choice.p, rtol=1e-5)
    p, scene = opened(card).ask(SYSTEM, shown.part, both_questions(2, "lamp"), PATIENCE_S)
    np.testing.assert_allclose(
        [*choice.p, choice.elsewhere, choice.scene], [*p, scene[0]], atol=1e-5
    )


# -- errors ---------------------------------------------------------------------------------


def change_json(file, **changes):
    def change(card):
        path = card.path / file
        path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))

    return change


def template(text):
    return change_json("chat_template.json", chat_template=text)


def write(file, content):
    return lambda card: (card.path / file).write_bytes(content)


def other_tokenizer(card):
    special = [token for token in tiny_vlm.SPECIAL["smolvlm"] if token != "<image>"]
    made = train_tokenizer([*special, "<image>"], letters="ABCDEFGH")
    assert not [t for t in vocabulary(made) if t.strip() == "J"]
    made.save(str(card.path / "tokenizer.json"))


def network(part, make):
    """Put another network in a part's place."""

    def change(card):
        save(make(), str(card.path_of(getattr(card, part))))

    return change


def encoder(rows, **names):
    g = Graph(np.random.default_rng(0), F32)
    g("Identity", g.constant(np.zeros((rows, HIDDEN), np.float32)), out="image_features")
    wanted = {"pixel_values": (F32, None), "pixel_attention_mask": (TensorProto.BOOL, None)}
    return g.model({**wanted, **names}, {"image_features": (F32, [rows, HIDDEN])})


def greedy_encoder():
    g = Graph(np.random.default_rng(0), F32)
    size = g("Mul", g("Shape", "pixel_values"), g.constant([1, 1, 1, 1 << 20, 1 << 24]))
    large = g("Expand", g.constant(np.float32(0)), size)
    g("Reshape", large, g.constant([-1, HIDDEN]), out="image_features")
    return g.model(
        {"pixel_values": (F32, ["b", "i", 3, "h", "w"])}, {"image_features": (F32, None)}
    )


def nan_decoder():
    rng = np.random.default_rng(0)
    made = tiny_vlm.decoder(400, rng, "smolvlm", F32)
    made.graph.node[-1].output[0] = "sum"
    made.graph.node.append(helper.make_node("Log", ["negative"], ["logits"]))
    made.graph.node.insert(-1, helper.make_node("Sub", ["sum", "sum"], ["zero"]))
    made.graph.node.insert(-1, helper.make_node("Sub", ["zero", "one"], ["negative"]))
    one = helper.make_tensor("one", F32, [], [1.0])
    made.graph.initializer.append(one)
    return made


def short_decoder():
    return tiny_vlm.decoder(50, np.random.default_rng(0), "smolvlm", F32)


def change_network(part, change):
    """Put a changed network in its own place."""

    def changed(card):
        path = str(card.path_of(getattr(card, part)))
        made = load(path)
        change(made.graph)
        save(made, path)

    return changed


def lose_tensor(graph):
    del graph.initializer[0]


def want_deepstack(graph):
    shape = ["b", "n", HIDDEN]
    graph.input.append(helper.make_tensor_value_info("deepstack_features_0", F32, shape))


def lie_about(*dims):
    """Change the size of the largest tensor."""

    def change(graph):
        largest = max(graph.initializer, key=lambda tensor: len(tensor.raw_data))
        largest.dims[:] = dims

    return change


def keep_more_heads(graph):
    for value in graph.input:
        if value.name.startswith("past_key_values."):
            value.type.tensor_type.shape.dim[1].dim_value = 1 << 40


def without_past():
    made = tiny_vlm.decoder(400, np.random.default_rng(0), "smolvlm", F32)
    del made.graph.output[1:]
    return made


BROKEN = {
    "no file": (lambda c: c.path_of(c.decoder).unlink(), "is not there; run `edge models pull"),
    "no hash": (
        lambda c: c.path_of(c.decoder).with_name("decoder_model_merged.onnx.json").unlink(),
        "no sha256 to check the file against",
    ),
    "truncated": (
        lambda c: write(c.decoder.file, c.path_of(c.decoder).read_bytes()[:-9])(c),
        r"truncated: \d+ of \d+ bytes",
    ),
}
WRONG = {
    "not onnx": (write("onnx/decoder_model_merged.onnx", b"garbage"), "not an ONNX model"),
    "not json": (write("config.json", b"{"), "config.json: model tiny: cannot be read"),
    "no tokenizer": (write("tokenizer.json", b"{}"), "tokenizer.json: not a tokenizer"),
    "image token of another": (change_json("config.json", image_token_id=99999), "is 99999, which"),
    "no template": (change_json("chat_template.json", chat_template=None), "no chat template"),
    "template that does not parse": (template("{% if %}"), "chat template, line 1: Templ"),
    "template that refuses": (
        template("{{ raise_exception('no system role') }}"), "TemplateError: no system role",
    ),
    "template that would leave its sandbox": (
        template("{{ messages.__class__.__mro__ }}"), "SecurityError",
    ),
    "template that drops the question": (
        template("<image>{{ messages[0].content[0].text }}"), "leaves out 'Among directions",
    ),
    "template without an image": (
        template(
            "{% for m in messages %}{% for l in m.content %}{{ l.text }}{% endfor %}{% endfor %}"
        ),
        "shows 0 images .<image>., expected 1",
    ),
    "a letter is missing": (other_tokenizer, "no token for the answer 'J'"),
    "images unknown": (
        change_json("preprocessor_config.json", image_processor_type="Other"),
        "'Other' is not supported .choices: Idefics3ImageProcessor",
    ),
    "images badly told": (
        change_json("preprocessor_config.json", image_mean="x"), "is incomplete or invalid: ",
    ),
    "more tokens an image than there may be": (
        change_json("processor_config.json", image_seq_len=101), "but image_tokens of the card is",
    ),
    "features of another length": (
        network("vision_encoder", lambda: encoder(3)), "makes 3 rows of an image, but its prompt",
    ),
    "encoder of another family": (
        network("vision_encoder", lambda: encoder(4, depth=(F32, None))), "needs the input 'depth'",
    ),
    "out of memory": (network("vision_encoder", greedy_encoder), "model tiny: out of memory"),
    "logits that are no numbers": (network("decoder", nan_decoder), "are not finite"),
    "fewer logits than tokens": (network("decoder", short_decoder), "50 logits, fewer than"),
    "a decoder that keeps nothing": (
        network("decoder", without_past), "decoder has no output present.0.key",
    ),
    "a decoder that wants more of an image": (
        change_network("decoder", want_deepstack), "encoder has no output deepstack_features_0",
    ),
    **{
        f"a tensor of the {part} is missing": (
            change_network(part, lose_tensor), "onnxruntime cannot load the model: Invalid model",
        )
        for part in ("vision_encoder", "embed_tokens", "decoder")
    },
    **{
        f"a tensor that is said to be {dims}": (
            change_network("decoder", lie_about(*dims)), "onnxruntime cannot load the model",
        )
        for dims in ((1 << 20, 1 << 20), (1 << 40, 1 << 40), (-5, 7))
    },
    "keys of heads that there are not": (
        change_network("decoder", keep_more_heads), "onnxruntime cannot load the model",
    ),
    **{
        f"images of {told}": (
            change_json("preprocessor_config.json", **told), "incomplete or invalid: longest_edge",
        )
        for told in (
            {"max_image_size": {"longest_edge": 1 << 20}}, {"size": {"longest_edge": 1 << 40}},
            {"max_image_size": {"longest_edge": 0}}, {"size": {"longest_edge": -3}},
        )
    },
    "a filter that there is not": (
        change_json("preprocessor_config.json", resample=99), "invalid: 99 is not a valid",
    ),
    "an image that is no number": (
        change_json("preprocessor_config.json", image_std=[float("nan")] * 3), "not finite",
    ),
    "an encoder for a decoder": (
        network("decoder", lambda: encoder(4)), "decoder has no input past_key_values.N.key",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", [*BROKEN, *WRONG])
def test_a_broken_model_is_reported_in_one_line(models_dir, what):
    card = publish(models_dir, "smolvlm")
    spoil, says = {**BROKEN, **WRONG}[what]
    spoil(card)
    if what in WRONG:  # damage that no hash shows
        pin(card)
    with pytest.raises(ModelError, match=says) as raised:
        opened(card)
    assert str(raised.value).isprintable()


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ({"patch_size": 1 << 16}, r"patch_size is 65536, expected 1 to 4096"),
        ({"patch_size": 0}, "patch_size is 0"),
        ({"merge_size": 4096}, "patch_size times merge_size is 16384"),
        ({"temporal_patch_size": 1 << 40}, "temporal_patch_size is 1099511627776"),
        ({"max_pixels": 0, "size": {"longest_edge": 1}}, "max_pixels 1"),
        ({"min_pixels": 1 << 60}, "tokens, but image_tokens of the card is 100"),
    ],
)
def test_wrong_sizes_of_patches_are_reported_in_one_line(models_dir, told, says):
    card = publish(models_dir, "qwen2-vl")
    change_json("preprocessor_config.json", **told)(card)
    pin(card)
    with pytest.raises(ModelError, match=says) as raised:
        opened(card)
    assert str(raised.value).isprintable()


@pytest.mark.parametrize("provider", ["tensorrt", "TensorrtExecutionProvider"])
def test_tensorrt_is_refused(models_dir, provider):
    card = publish(models_dir, "smolvlm")
    says = r"inputs without a fixed shape, .* in perception\.choice\.providers"
    with pytest.raises(ModelError, match=says) as raised:
        LanguageModel(card, EVERY, providers=[provider])
    assert str(raised.value).isprintable()


def changed_bytes(content, chance):
    """As a bad disk or a bad download leaves it."""
    made = bytearray(content)
    for _ in range(chance.choice((1, 1, 2, 8))):
        at, n = chance.randrange(len(made)), chance.choice((1, 4, 50))
        made[at : at + chance.choice((0, 1, n))] = chance.choice(
            (b"", chance.randbytes(1), made[at : at + 2 * n])
        )
        made = made or bytearray(b"x")
    return bytes(made)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Return a valid card for each family, and its files' content."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGE_CACHE_DIR", str(tmp_path_factory.mktemp("sound")))
        folder = resources.models_dir()
        folder.mkdir(parents=True)
        cards = {family: publish(folder, family, family) for family in FAMILIES}
        yield {
            family: (card, {part.file: card.path_of(part).read_bytes() for part in card.parts})
            for family, card in cards.items()
        }


@pytest.mark.parametrize("family", FAMILIES)
@given(st.randoms(use_true_random=False), st.data())
def test_changed_files_are_reported_or_harmless(sound, family, chance, data):
    """Though their hashes are right: nothing but a ModelError is raised, whatever the bytes."""
    card, contents = sound[family]
    file = data.draw(st.sampled_from(sorted(contents)))
    path = card.path / file
    path.write_bytes(changed_bytes(contents[file], chance))
    pin(card)
    told = ""
    try:
        model = opened(card)
        model.ask(SYSTEM, a_view(model), EVERY, PATIENCE_S)
    except ModelError as error:
        told = str(error)
    finally:
        path.write_bytes(contents[file])
    assert told.isprintable()
    assert len(told) < 1200


def test_a_card_of_another_task_or_unknown_is_refused(models_dir):
    for name, says in [
        ("none", "no such card"),
        ("mini-house-text", "of task 'text', not 'choice'"),
    ]:
        with pytest.raises(ModelError, match=f"perception.choice.card: .*{says}"):
            made(card=name)


def test_external_weights_must_be_listed_in_the_card(models_dir):
    card = publish(models_dir, "text")
    path = card.path_of(card.decoder)
    made = tiny_vlm.decoder(600, np.random.default_rng(0), "text", F32)
    save(
        made,
        str(path),
        save_as_external_data=True,
        location="decoder.onnx_data",
        size_threshold=512,
    )
    pin(card)
    with pytest.raises(ModelError, match=r"keeps weights in another file, 'decoder.onnx_data'"):
        opened(card)
    others = [*card.model_dump()["others"], {"file": "onnx/decoder.onnx_data"}]
    whole = card.model_validate({**card.model_dump(), "others": others})
    pin(whole)
    assert (
        opened(whole).ask(SYSTEM, "nothing", both_questions(2, "lamp"), PATIENCE_S)[0].sum() > 0.99
    )


def test_a_question_that_is_too_long_is_not_asked(models_dir):
    model = opened(publish(models_dir, "text").model_copy(update={"max_tokens": 300}))
    with pytest.raises(ModelError, match=r"has \d+ tokens, but max_tokens of its card is 300"):
        model.ask(SYSTEM, "bed " * 400, both_questions(2, "lamp"), PATIENCE_S)
    assert len(model.ask(SYSTEM, "bed", both_questions(2, "lamp"), PATIENCE_S)) == 2


def test_an_image_token_in_a_target_is_an_error(models_dir):
    model = opened(publish(models_dir, "smolvlm"))
    with pytest.raises(ModelError, match=r"shows 2 images .<image>., expected 1"):
        model.ask(SYSTEM, a_view(model), both_questions(2, "<image>"), PATIENCE_S)


# -- time -------------------------------------------------------------------------------------


def endless_encoder(rounds):
    """Count to `rounds`, then return the features."""
    g = Graph(np.random.default_rng(0), F32)
    tick = parser.parse_graph(
        f"tick (int64 round, bool more, float[4,{HIDDEN}] x) => (bool go, float[4,{HIDDEN}] y)"
        "{ go = Identity (more) y = Add (x, x) }"
    )
    dark = g("Less", g("ReduceMax", "pixel_values", keepdims=0), g.constant(np.float32(0.0)))
    count = g("Where", dark, g.constant(np.int64(1)), g.constant(np.int64(rounds)))
    start = g.constant(np.zeros((4, HIDDEN), np.float32))
    g("Loop", count, g.constant(np.bool_(True)), start, out="image_features", body=tick)
    return g.model(
        {"pixel_values": (F32, ["b", "i", 3, "h", "w"])}, {"image_features": (F32, [4, HIDDEN])}
    )


@pytest.fixture
def endless(models_dir):
    """Return a model that answers only for a dark image."""
    card = publish(models_dir, "smolvlm").model_copy(update={"image_tokens": 4})
    network("vision_encoder", lambda: endless_encoder(1 << 50))(card)
    pin(card)
    return opened(card)


def test_an_answer_that_takes_too_long_is_broken_off(endless):
    light, dark = (np.full((32, 32, 3), value, np.uint8) for value in (255, 0))
    with pytest.raises(ModelError, match=r"tiny: no answer within 0\.05 s .*time_limit_s"):
        endless.ask(SYSTEM, light, EVERY, 0.05)
    assert len(endless.ask(SYSTEM, dark, EVERY, PATIENCE_S)) == 2
    with pytest.raises(ModelError, match="no answer within 0 s"):
        endless.ask(SYSTEM, dark, EVERY, 0.0)


def test_closing_aborts_a_running_question(endless):
    raised = []

    def ask():
        try:
            endless.ask(SYSTEM, np.full((32, 32, 3), 255, np.uint8), EVERY, PATIENCE_S)
        except ModelError as error:
            raised.append(str(error))

    before = endless._deadline.options
    thread = threading.Thread(target=ask)
    thread.start()
    eventually(lambda: endless._deadline.options is not before)
    endless.close()
    thread.join(PATIENCE_S)
    assert raised == ["model tiny: aborted: the model was closed"]


def test_the_card_knows_its_files_and_refuses_unknown_keys(models_dir):
    """It is read like any other card, and refused if its parts do not fit together."""
    publish(models_dir, "smolvlm")
    card = load_card("tiny")
    assert card.is_here()
    assert len(card.networks) == 3
    assert math.isclose(sum(1 for part in card.parts), 3 + len(card.others))
    bad = (models_dir / "tiny.yaml").read_text().replace("embed_tokens:\n", "x_tokens:\n")
    (models_dir / "tiny.yaml").write_text(bad)
    with pytest.raises(ModelError, match=r"x_tokens"):
        load_card("tiny")
