"""Messages to and from a model's server."""

from __future__ import annotations

import contextlib
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from edge.perception.runtime import kserve_messages as messages
from edge.perception.runtime.kserve_messages import HEADER_LENGTH, infer_answer, infer_request

ONE = {"name": "boxes", "datatype": "FP32", "shape": [1, 2], "data": [0.5, 1.5]}


def answer(*entries, tail: bytes = b"", **change) -> tuple[bytes, str]:
    head = json.dumps({"outputs": [{**entry, **change} for entry in entries]}).encode()
    return head + tail, str(len(head))


def test_nothing_asked_is_nothing_found():
    assert infer_answer(*answer(), {}) == {}


def test_a_request_follows_the_kserve_protocol():
    inputs = {"images": np.ones((1, 2), np.float32), "tokens": np.array([[7]])}
    headers, body = infer_request(inputs, ["boxes"], binary=False)
    assert headers == {"Content-Type": "application/json"}
    assert json.loads(body) == {
        "inputs": [
            {"name": "images", "shape": [1, 2], "datatype": "FP32", "data": [1.0, 1.0]},
            {"name": "tokens", "shape": [1, 1], "datatype": "INT64", "data": [7]},
        ],
        "outputs": [{"name": "boxes", "parameters": {"binary_data": False}}],
    }
    headers, body = infer_request(inputs, ["boxes"], binary=True)
    length = int(headers[HEADER_LENGTH])
    assert [e["parameters"] for e in json.loads(body[:length])["inputs"]] == [
        {"binary_data_size": 8}, {"binary_data_size": 8},
    ]  # fmt: skip
    assert body[length:] == np.ones(2, "<f4").tobytes() + np.array([7], "<i8").tobytes()


@given(hnp.arrays(np.float32, hnp.array_shapes(max_dims=3, max_side=4)), st.booleans())
def test_arrays_survive_a_request_and_answer(array, binary):
    headers, body = infer_request({"x": array}, [], binary)
    told = json.loads(body[: int(headers.get(HEADER_LENGTH, len(body)))])
    head = json.dumps({"outputs": told["inputs"]}).encode()
    tail = body[int(headers[HEADER_LENGTH]) :] if binary else b""
    found = infer_answer(head + tail, str(len(head)) if binary else None, {"x": array.shape})
    np.testing.assert_array_equal(found["x"], array)


SIZE = {"parameters": {"binary_data_size": 8}}
LIES = [
    (b"", None, "not JSON"),
    (b"[]", None, ""),
    (b"[" * 100_000, None, "not JSON"),
    (b'{"outputs": 3}', None, "the answer has no list of outputs"),
    (b'{"outputs": [3]}', None, "the answer has no list of outputs"),
    (*answer({**ONE, "name": ["boxes"]}), "the answer lacks the output 'boxes'"),
    (*answer(), "the answer lacks the output 'boxes'"),
    (*answer(ONE, ONE), "the answer has the output 'boxes' twice"),
    (*answer(ONE, tail=b"xx"), "2 bytes of the answer belong to no output"),
    (answer(ONE)[0], "9" * 11, f"{HEADER_LENGTH} is '99999999999', expected 0 to "),
    (answer(ONE)[0], "-1", f"{HEADER_LENGTH} is '-1', expected 0 to "),
    (answer(ONE)[0], "²", f"{HEADER_LENGTH} is '²', expected 0 to "),
    (*answer(ONE, datatype="FP64"), "'boxes' has the datatype FP64, must be FP32"),
    (*answer(ONE, datatype=None), "'boxes' has the datatype None, must be FP32"),
    (*answer(ONE, shape=[2, 1]), "'boxes' has the shape [2, 1], must be [1, ?]"),
    (*answer(ONE, shape=[1, -2]), "'boxes' has the shape [1, -2], must be [1, ?]"),
    (*answer(ONE, shape=[1, True]), "'boxes' has the shape [1, True], must be [1, ?]"),
    (*answer(ONE, shape=[1, 1 << 50]), "'boxes' has the shape [1, 1125899906842624], must be"),
    (*answer(ONE, shape=[1] * 99), "'boxes' has the shape [1, 1, "),
    (*answer(ONE, shape=None), "'boxes' has the shape None, must be [1, ?]"),
    (*answer(ONE, data=[1.0]), "the data of 'boxes' is not 2 numbers"),
    (*answer(ONE, data=[[1.0], 2.0]), "the data of 'boxes' is not an array"),
    (*answer(ONE, data=["1", "2"]), "the data of 'boxes' is not 2 numbers"),
    (*answer(ONE, data=[None, 1.0]), "the data of 'boxes' is not 2 numbers"),
    (*answer(ONE, data=[True, False]), "the data of 'boxes' is not 2 numbers"),
    (*answer(ONE, data=[10**400, 1]), "the data of 'boxes' is not 2 numbers"),
    (*answer(ONE, data=None), "the data of 'boxes' is not 2 numbers"),
    (*answer(ONE, **SIZE), "the answer ends before the bytes of 'boxes'"),
    (*answer(ONE, parameters={"binary_data_size": 4}, tail=b"1234"),
     "'boxes' has 4 bytes, must be 8"),
    (*answer(ONE, parameters={"binary_data_size": -4}), "binary_data_size is -4"),
    (*answer(ONE, parameters={"binary_data_size": "8"}), "binary_data_size is 8"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "length", "why"), LIES)
def test_a_mismatched_answer_is_refused(body, length, why):
    with pytest.raises(ValueError, match=r"^[^\n]*$") as error:
        infer_answer(body, length, {"boxes": (1, None)})
    assert str(error.value).startswith(why)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(
        st.sampled_from(["outputs", "name", "shape", "datatype", "data", "parameters",
                         "binary_data_size", "boxes"]), inner, max_size=5,
    ),
    max_leaves=20,
)  # fmt: skip


@given(st.binary(max_size=80) | json_values.map(lambda v: json.dumps(v).encode()),
       st.none() | st.text(max_size=5))  # fmt: skip
def test_any_answer_raises_only_value_errors(body, length):
    for read in (
        lambda: infer_answer(body, length, {"boxes": (1, None)}),
        lambda: messages.check_metadata(body, {"x": ("FP32", (1,))}, {}),
        lambda: messages.speaks_binary(body),
    ):
        with contextlib.suppress(ValueError):
            read()


@given(json_values)
def test_any_output_raises_only_value_errors(value):
    entry = {**ONE, **(value if isinstance(value, dict) else {"data": value}), "name": "boxes"}
    with contextlib.suppress(ValueError):
        found = infer_answer(json.dumps({"outputs": [entry]}).encode(), None, {"boxes": (1, None)})
        assert found["boxes"].dtype == np.float32
        assert found["boxes"].shape[0] == 1


IMAGES = {"name": "images", "datatype": "FP32", "shape": [-1, 3, 4, 4]}


@pytest.mark.parametrize(
    ("metadata", "why"),
    [
        ({}, ""),
        ({"inputs": [], "outputs": None}, ""),
        ({"inputs": [IMAGES]}, ""),
        ({"inputs": [{**IMAGES, "name": "input.1"}]},
         "the model has no 'images' among its inputs (input.1)"),
        ({"inputs": [{**IMAGES, "datatype": "FP16"}]},
         "'images' is FP16 (-1, 3, 4, 4), must be FP32 [1, 3, 4, 4]"),
        ({"inputs": [{**IMAGES, "shape": [1, 3, 8, 8]}]},
         "'images' is FP32 (1, 3, 8, 8), must be FP32 [1, 3, 4, 4]"),
        ({"outputs": [{"name": "a\nb"}]}, "the model has no 'boxes' among its outputs (a b)"),
    ],
)  # fmt: skip
def test_a_model_of_other_inputs_or_outputs_is_reported(metadata, why):
    def check():
        inputs, outputs = {"images": ("FP32", (1, 3, 4, 4))}, {"boxes": ("FP32", (1, None, 4))}
        messages.check_metadata(json.dumps(metadata).encode(), inputs, outputs)

    if not why:
        return check()
    with pytest.raises(ValueError, match=r"^[^\n]*$") as error:
        check()
    assert str(error.value) == why
