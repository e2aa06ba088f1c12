"""Processes for the tests of orders: `service ENDPOINT`, or `order` and arguments."""

from __future__ import annotations

import argparse
import sys
import time

from edge.bus.desk import Request
from edge.bus.session import open_session
from edge.config import Zenoh
from edge.errors import UserError
from edge.loop.mission_desk import MissionDesk
from edge.mission import order
from edge.mission.ltl import parse, to_text

SETTINGS = Zenoh()


def prepare(instruction: str | None, formula: str | None) -> str:
    """The formula; `slow <formula>` is understood only when a line comes in."""
    text = instruction or formula
    if text.startswith("slow "):
        print("slow", flush=True)
        sys.stdin.readline()
        text = text[len("slow ") :]
    if "unicorn" in text:
        raise UserError("instruction: not understood: 'unicorn'")
    return to_text(parse(text))


def act(request: Request, state: dict) -> None:
    """What a service does with an order."""
    if request.do == "new":
        state.update(formula=request.prepared, phase="exploring", paused=False)
    elif request.do == "resume" and not state["paused"]:
        return request.refuse("nothing is paused")
    elif request.do == "cancel":
        state.update(phase="cancelled")
    elif request.do in ("pause", "resume"):
        state.update(paused=request.do == "pause")
    request.answer({**state, "english": f"do {state['formula']}", "reached": ["bed", "tv"]})


def service(endpoint: str) -> None:
    """Ticks for ever; says `ready` when it takes orders."""
    state = {"formula": "F chair", "phase": "exploring", "paused": False}
    with open_session(Zenoh(endpoint=endpoint), "listen") as session:
        desk = MissionDesk(session, SETTINGS, prepare)
        print("ready", flush=True)
        while True:
            time.sleep(0.02)
            # All that waits, as the loop does: one a tick would let orders that pass starve others.
            while (request := desk.poll()) is not None:
                act(request, state)


def main(role: str, *arguments: str) -> int:
    if role == "service":
        service(*arguments)
    parser = argparse.ArgumentParser()
    order.add_arguments(parser)
    args = parser.parse_args(arguments)
    try:
        return args.handler(args)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
