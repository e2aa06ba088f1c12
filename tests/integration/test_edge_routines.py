"""Routines of a running service, by command: wait, check, patrol, come here."""

from __future__ import annotations

import json
import os

from edge_processes import LOCKED, write_config
from live_patience import eventually


def test_routines_by_command(edge, endpoint, tmp_path, command):
    config = write_config(
        tmp_path, zenoh={"endpoint": endpoint}, sensors={"camera": {"width_px": 160,
        "height_px": 128}}, mission={"on_request": True}, **LOCKED,
    )  # fmt: skip
    edge("run", config).says("ready:")
    edge("sim", config)

    def status() -> tuple[str, str]:
        answer = json.loads(command("mission", "status", config, "--json")[1])
        return answer["phase"], answer["reason"]

    def new(formula: str, *options: object) -> None:
        code, said = command("mission", "new", config, formula, "--formula", *options)
        assert code == 0, said

    new('F (wait & F "check television")')
    eventually(lambda: status() == ("waiting", "waiting until told to go on"))
    assert command("mission", "resume", config)[0] == 0
    eventually(lambda: status()[0] == "reached")
    assert status()[1].startswith("yes, there is a television ")
    new('F "wait 1 s" & F start', "--rounds", 2)
    eventually(lambda: status() == ("reached", "2 rounds done"))
    code, said = command("mission", "new", config, "F caller", "--formula")
    assert (code, "send from_pose: [x_m, y_m, yaw_rad]" in said) == (os.EX_DATAERR, True), said
    new("F caller", "--from-pose", "2.0,1.6,90")
    eventually(lambda: status()[0] == "reached")
