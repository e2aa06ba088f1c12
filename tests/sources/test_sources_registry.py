"""Sources by name, and of one's own."""

from __future__ import annotations

import pytest
from fake_zenoh import Flooded
from simulated import simulated

from edge.config import ConfigError
from edge.sources import find_source
from edge.sources.zenoh import ZenohSource


class Mine:
    def __init__(self, config, session, rate_hz: int) -> None:
        self.rate_hz = rate_hz


def configured(kind: str, **options):
    return simulated({"source": {"kind": kind, "options": options}}, "f.yaml")


def test_a_robot_is_heard_over_zenoh():
    assert isinstance(find_source(simulated())(Flooded("", ())), ZenohSource)


def test_a_source_of_ones_own():
    assert find_source(configured(f"{__name__}:Mine", rate_hz=5))(None).rate_hz == 5


@pytest.mark.parametrize(
    ("kind", "options", "says"),
    [
        ("zenho", {}, r"kind: unknown 'zenho' \(choices: zenoh, or module:Class\)"),
        ("zenoh", {"rate": 3}, "options: got an unexpected keyword argument 'rate'"),
        ("no_such_module:A", {}, "kind: 'no_such_module:A': ModuleNotFoundError: .* PYTHONPATH"),
        ("edge.sources:Nothing", {}, "kind: 'edge.sources:Nothing': AttributeError"),
    ],
)
def test_what_is_no_source_is_told_in_one_line(kind, options, says):
    with pytest.raises(ConfigError, match=rf"^f\.yaml: source\.{says}") as caught:
        find_source(configured(kind, **options))
    assert "\n" not in str(caught.value)
