"""The missions that a soak gives: about objects that the detector knows."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated

from edge.errors import UserError
from edge.lab.eval.soak import missions
from edge.lab.eval.soak.missions import MissionFeeder, known_labels


def knowing(*words: str):
    """Return a configuration whose detector knows these words; its house is `demo`."""
    return simulated({"perception": {"detector": {"kind": "onnx", "background": list(words)}}})


@pytest.mark.parametrize(("words", "got"), [((), "none"), (("trash can", "unicorn"), "trash can")])
def test_too_few_known_objects_are_reported(words, got):
    config = knowing(*words)
    problem = rf"perception\.detector\.background: .* world demo .* got {got}$"
    with pytest.raises(UserError, match=problem):
        known_labels(config, config.sim.world)


def test_labels_are_those_that_the_detector_knows():
    config = knowing("bin", "sofa", "unicorn")
    assert known_labels(config, config.sim.world) == ["sofa", "trash can"]
    assert len(known_labels(simulated(), config.sim.world)) > 4  # the simulator's detector: all


def test_a_later_house_with_too_few_objects_gets_sentences_of_the_first(monkeypatch):
    def labels(config, world):
        if world == "later":
            raise UserError("too few")
        return ["bed", "sofa"]

    monkeypatch.setattr(missions, "known_labels", labels)
    harness = SimpleNamespace(config=simulated(), house=1, world="later")
    feeder = MissionFeeder(harness, None, np.random.default_rng(0))
    found = {feeder._next_instruction() for _ in range(40)}
    assert "go to the sofa, then to the bed" in found
    assert "find the bed" in found
