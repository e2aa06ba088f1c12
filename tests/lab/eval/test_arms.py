"""Arms: their settings, and when two arms differ."""

from __future__ import annotations

import pytest
from small_house import small_house

from edge.config import parse
from edge.errors import ConfigError
from edge.lab.eval.arms import make_arms, merged, parse_arm, read_arms


def test_an_arm_has_merged_settings_and_a_distinct_id(tmp_path):
    config = small_house(tmp_path, policy={"kind": "hvl", "w_vl": 2.0})
    near, hvl = make_arms(config, {"near": {"policy": {"kind": "nearest_frontier"}}, "hvl": {}})
    whole = parse(merged(near.base, near.settings))
    assert whole.policy.kind == "nearest_frontier"
    assert near.id != hvl.id


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"sim": {"start": [1, 1, 0]}}, True),  # episodes say these
        ({"mission": {"target": "sofa"}}, True),
        ({"zenoh": {"endpoint": "tcp/127.0.0.1:9"}}, True),
        ({"mission": {"time_limit_s": 9.0}}, False),
        ({"perception": {"detector": {"kind": "sim", "miss_rate": 0.2}}}, False),
        ({"sensors": {"camera": {"hfov_deg": 90}}}, False),
    ],
)
def test_the_id_depends_on_all_that_an_arm_decides(tmp_path, change, same):
    config = small_house(tmp_path)
    one, other = make_arms(config, {"one": {}, "other": change})
    assert (one.id == other.id) == same


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"policy": {"kind": "hvll"}}, r"arm x: policy.kind: unknown 'hvll'"),
        ({"policyy": {}}, "unknown key"),
        ({"config": "nowhere.yaml"}, "no such file"),
    ],
)
def test_an_invalid_arm_is_refused(tmp_path, settings, message):
    with pytest.raises(ConfigError, match=message):
        make_arms(small_house(tmp_path), {"x": settings})


@pytest.mark.parametrize("setting", ["policy.kind", "=3", "a..b=1", "a={"])
def test_invalid_settings_are_refused(setting):
    with pytest.raises(ConfigError, match="--arm a"):
        parse_arm(["a", setting])


def test_columns_are_read_from_a_file(tmp_path):
    path = tmp_path / "columns.yaml"
    path.write_text("hvl:\nnear: {policy: {kind: nearest_frontier}}\n")
    assert read_arms(path) == {"hvl": {}, "near": {"policy": {"kind": "nearest_frontier"}}}


@pytest.mark.parametrize("text", ["", "[]", "a: 3", "a: ["])
def test_files_of_no_columns_are_refused(tmp_path, text):
    path = tmp_path / "columns.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"columns\.yaml"):
        read_arms(path)
