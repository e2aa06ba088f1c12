"""Sources by name, and of one's own."""

from __future__ import annotations

import pytest
from fake_zenoh import Flooded
from simulated import simulated

from edge.config import ConfigError
from edge.sources import REGISTRY, make_source
from edge.sources.zenoh import ZenohSource


class Mine:
    def __init__(self, config, session, rate_hz: int) -> None:
        self.rate_hz = rate_hz


def configured(kind: str, **options):
    return simulated({"source": {"kind": kind, "options": options}}, "f.yaml")


def test_a_robot_is_heard_over_zenoh():
    assert isinstance(make_source(simulated(), Flooded("", ())), ZenohSource)


@pytest.mark.parametrize("kind", REGISTRY)
def test_every_name_of_the_registry_is_one_for_the_configuration(kind):
    assert configured(kind).source.kind == kind


def test_a_source_of_ones_own():
    assert make_source(configured(f"{__name__}:Mine", rate_hz=5), None).rate_hz == 5


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("zenho", r"kind: unknown 'zenho' \(choices: zenoh, or module:Class\)"),
        ("no_such_module:A", "kind: 'no_such_module:A': ModuleNotFoundError: .*on PYTHONPATH"),
        ("edge.sources:Nothing", "kind: 'edge.sources:Nothing': AttributeError"),
        (f"{__name__}:Mine", r"options: missing a required argument: 'rate_hz'"),
    ],
)
def test_what_is_no_source_is_told_in_one_line(kind, says):
    with pytest.raises(ConfigError, match=rf"^f\.yaml: source\.{says}") as caught:
        make_source(configured(kind), None)
    assert "\n" not in str(caught.value)
