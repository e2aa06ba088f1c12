"""Messages between service and model process, and their refusals."""

from __future__ import annotations

import errno
import json
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from edge.perception.embedding.text import PromptError
from edge.perception.process import wire
from edge.perception.process.wire import FrameFile, FrameView, ModelProcessError
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import ModelHealth
from edge.text import read_json_object
from edge.types import ContextBoxes, Detections

PROMPTS = ("chair", "déjà vu")
REALS = st.floats(-1e6, 1e6, width=32)
UNITS = st.floats(0, 1, width=32)


def detections(xyxy, score, class_id, competing_score, around=0):
    context = ContextBoxes(
        np.ones((around, 4), np.float32), np.full(around, 0.75, np.float32),
        np.zeros(around, np.int32), ("lamp",),
    )  # fmt: skip
    return Detections(None, xyxy, score, class_id, PROMPTS, competing_score, context)


def encode(found, health=("ok", ""), seq=3):
    answer = wire.encode_answer(seq, found, health, invalid_boxes=2)
    header, _, block = answer.partition(wire.END_OF_HEADER)
    return read_json_object(header), block


def some(n=2, around=0):
    xyxy = np.arange(4 * n, dtype=np.float32).reshape(n, 4)
    return detections(
        xyxy, np.full(n, 0.5, np.float32), np.arange(n, dtype=np.int32),
        np.full(n, 0.25, np.float32), around,
    )  # fmt: skip


@pytest.mark.parametrize("around", [0, 3])
def test_context_boxes_are_transferred(around):
    sent = some(2, around=around)
    came = wire.decode_answer(3, *encode(sent)).found
    assert came.context.words == ("lamp",)
    for name in ("xyxy_px", "score", "class_id"):
        ours, theirs = getattr(came.context, name), getattr(sent.context, name)
        assert (ours.dtype, ours.flags.writeable) == (theirs.dtype, True)
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(came.xyxy_px, sent.xyxy_px)


@given(st.data(), st.integers(0, 40))
def test_an_answer_arrives_bit_for_bit(data, n):
    found = detections(
        data.draw(npst.arrays(np.float32, (n, 4), elements=REALS)),
        data.draw(npst.arrays(np.float32, n, elements=UNITS)),
        data.draw(npst.arrays(np.int32, n, elements=st.integers(0, 1))),
        data.draw(npst.arrays(np.float32, n, elements=UNITS)),
    )
    told = ModelHealth("building engine", "a line")
    answer = wire.decode_answer(3, *encode(found, told))
    for name in ("xyxy_px", "score", "class_id", "competing_score"):
        sent, came = getattr(found, name), getattr(answer.found, name)
        assert came.dtype == sent.dtype
        assert came.tobytes() == sent.tobytes()
        assert came.flags.writeable
        assert came.flags.c_contiguous
    assert (answer.found.prompts, answer.health, answer.invalid_boxes) == (PROMPTS, told, 2)


def changed(**fields):
    """Return an answer with two boxes and a wrong header field."""
    header, block = encode(some())
    return {**header, **fields}, block


def with_array(name, value):
    found = some()
    getattr(found, name)[1] = value
    return encode(found)


DAMAGES = {
    "another image's": (changed(seq=2), "seq: expected 3, got 2"),
    "no number": (changed(n=None), "56 bytes do not fit n None boxes and 0 context boxes"),
    "more boxes than bytes": (changed(n=3), "56 bytes do not fit n 3 boxes and 0 context boxes"),
    "fewer boxes than bytes": (changed(n=1), "56 bytes do not fit n 1 boxes and 0 context boxes"),
    "less than none": (changed(n=-2), "56 bytes do not fit n -2 boxes and 0 context boxes"),
    "a real number": (changed(n=2.0), "56 bytes do not fit n 2.0 boxes and 0 context boxes"),
    "cut short": (
        (encode(some())[0], encode(some())[1][:-1]),
        "55 bytes do not fit n 2 boxes and 0 context boxes",
    ),
    "a prompt that is none": (changed(prompts=["chair", 3]), "prompts"),
    "one prompt": (changed(prompts="ch"), "prompts: .*got 'ch'"),
    "context that is none": (changed(context=["lamp"]), "context"),
    "no context": (changed(context=None), "context: expected an object, got None"),
    "one word of context": (changed(context={"n": 0, "words": "lamp"}), "context: .*got 'lamp'"),
    "more context than bytes": (
        changed(context={"n": 1, "words": ["lamp"]}),
        "fit n 2 boxes and 1 context boxes",
    ),
    "fewer than none": (
        changed(n=-1, context={"n": 3, "words": []}),
        "fit n -1 boxes and 3 context boxes",
    ),
    "less context than none": (
        changed(n=3, context={"n": -1, "words": []}),
        "fit n 3 boxes and -1 context boxes",
    ),
    "a count that is none": (changed(invalid_boxes="2"), "invalid_boxes: .*got '2'"),
    "no health": (changed(health=None), "health: .*got None"),
    "unknown health": (
        changed(health=["fine", ""]),
        "health: unknown state 'fine'.*choices: ok, building",
    ),
    "NaN in a box": (with_array("xyxy_px", np.nan), "boxes that are not finite"),
    "no end of a box": (with_array("xyxy_px", np.inf), "boxes that are not finite"),
    "NaN score": (with_array("score", np.nan), "scores that are not in 0 to 1"),
    "score above 1": (with_array("score", 1.5), "scores that are not in 0 to 1"),
    "NaN competing score": (with_array("competing_score", np.nan), "scores that are not in 0 to 1"),
    "negative competing score": (
        with_array("competing_score", -1),
        "scores that are not in 0 to 1",
    ),
    "class beyond the prompts": (with_array("class_id", 2), "a class_id is not from 0 to 1"),
    "negative class": (with_array("class_id", -1), "a class_id is not from 0 to 1"),
}


@pytest.mark.parametrize(("damaged", "says"), DAMAGES.values(), ids=DAMAGES.keys())
def test_a_damaged_answer_is_refused_with_one_line(damaged, says):
    with pytest.raises(ValueError, match=says) as error:
        wire.decode_answer(3, *damaged)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("raised", "kind", "says"),
    [
        (ModelError("tiny.onnx: damaged\nline two"), ModelError, "tiny.onnx: damaged\nline two"),
        (PromptError("prompt 'x': unknown"), PromptError, "prompt 'x': unknown"),
        (RuntimeError("a\nb"), ModelProcessError, "model tiny, in its process: RuntimeError: a b"),
    ],
)
def test_an_error_is_raised_again_on_the_other_side(raised, kind, says):
    header = json.loads(wire.encode_error(raised, seq=3))
    assert header["seq"] == 3
    with pytest.raises(kind) as error:
        wire.raise_error(header, "tiny")
    assert type(error.value) is kind
    assert str(error.value) == says


# -- images --------------------------------------------------------------------------------------


def image(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)


@pytest.fixture
def pair():
    file = FrameFile()
    yield file, FrameView(file.fd)
    file.close()


def test_nothing_was_written(pair):
    _, view = pair
    with pytest.raises(ValueError, match="0 bytes, 67 are needed"):
        view.read(1, (1, 1))


@given(st.lists(st.tuples(st.integers(1, 40), st.integers(1, 40)), min_size=1, max_size=6))
def test_images_of_any_size_arrive(sizes):
    file = FrameFile()
    view = FrameView(file.fd)
    for seq, hw in enumerate(sizes, start=1):
        rgb = image(*hw, seq)
        file.write(seq, rgb)
        np.testing.assert_array_equal(view.read(seq, hw), rgb)
        assert view.is_intact(seq)
    file.close()


@pytest.mark.parametrize("half", [wire._BEFORE, wire._AFTER], ids=["begun", "not ended"])
def test_a_torn_image_is_refused(pair, half):
    file, view = pair
    file.write(1, image(4, 4))
    file._seq[half] = 2
    seq = 1 if half == wire._BEFORE else 2
    with pytest.raises(ValueError, match=f"frame {seq}: overwritten"):
        view.read(seq, (4, 4))


def test_the_file_has_no_name_that_could_be_left_behind(pair):
    file, _ = pair
    file.write(1, image(4, 4))
    assert os.fstat(file.fd).st_nlink == 0
    assert os.fstat(file.fd).st_mode & 0o077 == 0


def test_missing_memory_is_an_error_not_a_signal(pair, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    file, view = pair
    file.write(1, image(4, 4))
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space left"):
        file.write(2, image(8, 8))
    view.read(1, (4, 4))
