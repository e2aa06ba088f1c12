"""The state of a mission in a checkpoint: it comes back as it was, or is refused."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from edge.host.checkpoint import Checkpoint
from edge.mission.checkpoint import MISSION, MissionState

BEGUN = MissionState(
    instruction="first the chair, then the tv",
    formula='F (chair & F "tv stand")',
    backend="grammar",
    english="reach the chair, then the tv stand",
    trace=("", "chair"),
    reached=("chair",),
    failed=(),
    detected=("tv stand",),
    target="tv stand",
    phase="approaching",
    reason="é: the cheapest",
    paused=False,
    elapsed_s=12.5,
    path_m=3.25,
    id="1f.2",
)
words = st.sampled_from(["chair", "tv stand"])
states = st.builds(
    MissionState, instruction=st.text(), formula=st.just(BEGUN.formula),
    backend=st.text(max_size=20), english=st.text(),
    trace=st.lists(words | st.just("")).map(tuple), reached=st.lists(words).map(tuple),
    failed=st.lists(words).map(tuple), detected=st.lists(words).map(tuple),
    target=st.none() | words, phase=st.text(max_size=20), reason=st.text(), paused=st.booleans(),
    elapsed_s=st.floats(0, 1e9), path_m=st.floats(0, 1e9), id=st.text(max_size=64),
)  # fmt: skip


@given(states)
def test_every_state_survives_a_round_trip(state):
    assert MISSION.decode(MISSION.encode(Checkpoint(state))).state == state


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"elapsed_s": float("nan")}, "elapsed_s"),
        ({"path_m": float("inf")}, "path_m"),
        ({"path_m": -1.0}, "path_m"),
        ({"formula": "F ("}, "formula"),
        ({"formula": "("}, "formula"),
        ({"trace": ("sofa",)}, "trace: 'sofa' is not in the formula"),
        ({"trace": ("chair",) * 10_001}, "trace"),
        ({"reached": ("",)}, "reached: '' is not in the formula"),
        ({"failed": ("sofa",)}, "failed"),
        ({"lost": ("sofa",)}, "lost: 'sofa' is not in the formula"),
        ({"detected": ("sofa",)}, "detected"),
        ({"target": "sofa"}, "target: 'sofa' is not in the formula"),
    ],
)
def test_a_contradictory_state_is_not_saved(change, text):
    with pytest.raises(ValueError, match=text) as caught:
        MISSION.encode(Checkpoint(replace(BEGUN, **change)))
    assert "\n" not in str(caught.value)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda x: st.lists(x, max_size=4) | st.dictionaries(st.text(max_size=5), x, max_size=4),
)


@given(st.sampled_from([*sorted(asdict(BEGUN)), "pose"]), json_values)
def test_any_field_value_is_a_state_or_an_error(name, value):
    said = json.dumps({**asdict(BEGUN), name: value})
    try:
        state = TypeAdapter(MissionState).validate_json(said)
        content = MISSION.encode(Checkpoint(state))
    except ValueError:
        return
    assert MISSION.decode(content).state == state
