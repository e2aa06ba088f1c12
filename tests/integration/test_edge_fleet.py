"""Three whole robots over one router, simulated: their services, simulators and controllers."""

from __future__ import annotations

import json
import os
import signal

import pytest
from edge_processes import LOCKSTEP, write_config

WORDS = "go to the bed, the sofa and the trash can in any order; never go to the toilet"
NAMES = ("anna", "bob", "carl")
FAST = {**LOCKSTEP, "EDGE__SIM__STEP_S": "0.2"}


@pytest.mark.slow
def test_three_robots_finish_a_mission_although_one_is_killed(edge, endpoint, tmp_path):
    zenoh = {"mode": "client", "endpoint": endpoint}
    config = write_config(tmp_path, zenoh=zenoh, mission={"on_request": True})
    edge("fleet", "router", endpoint).says("router: ready")
    services = {}
    for name in NAMES:
        own = {**FAST, "EDGE__ZENOH__PREFIX": f"robots/{name}"}
        services[name] = edge("run", config, **own)
        edge("sim", config, **own)
    for service in services.values():
        service.says("ready: waiting for a mission")
    twin = edge("run", config, **FAST, EDGE__ZENOH__PREFIX="robots/anna")
    assert twin.wait() == os.EX_UNAVAILABLE, twin.output
    assert "has the prefix robots/anna: stop that service" in twin.lines[-1]
    services["anna"].says("was started with the prefix robots/anna: that service ended")

    sharing = edge(
        "mission", "new", "--fleet", endpoint, WORDS, "--share", "--json", "--patience", "3"
    )
    for name in NAMES:
        services[name].says("target: ")
    sharing.says("carl gets: ")  # otherwise its answer is lost and its start stays unknown
    services["carl"].process.send_signal(signal.SIGKILL)
    sharing.says("carl is offline; another robot gets the part unless it is back within 3 s")
    assert sharing.wait() == 0, sharing.output
    told = json.loads("\n".join(sharing.lines[sharing.lines.index("{") :]))
    assert [part["phase"] for part in told["parts"]] == ["reached"] * 3
    assert {part["by"] for part in told["parts"]} <= {"anna", "bob"}
    shown = edge("fleet", "list", endpoint)
    assert shown.wait() == 0
    assert [line.split()[:2] for line in shown.lines[1:]] == [
        ["anna", "reached"],
        ["bob", "reached"],
    ]
