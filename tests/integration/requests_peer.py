"""Processes for the tests of requests: `service ENDPOINT`, or `request` and arguments."""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial

from edge.bus.requests import RequestServer
from edge.bus.session import open_session
from edge.bus.verbs import Request
from edge.cli.mission import add_arguments
from edge.config import ZenohConfig
from edge.errors import UserError
from edge.loop.requests.handlers import mission_verbs
from edge.mission.logic.ltl import parse, to_text

KEY = "edge/mission/request"


def prepare(instruction: str | None = None, formula: str | None = None) -> str:
    """Return the formula; `slow <formula>` waits for a line of input."""
    text = instruction or formula
    if text.startswith("slow "):
        print("slow", flush=True)
        sys.stdin.readline()
        text = text[len("slow ") :]
    if "unicorn" in text:
        raise UserError("instruction: not understood: 'unicorn'")
    return to_text(parse(text))


def act(state: dict, request: Request, now_ns: int) -> dict:
    """Handle a request as a service does."""
    if request.do == "new":
        state.update(formula=request.prepared, phase="exploring", paused=False)
    elif request.do == "resume" and not state["paused"]:
        raise UserError("nothing is paused")
    elif request.do == "cancel":
        state.update(phase="cancelled")
    elif request.do in ("pause", "resume"):
        state.update(paused=request.do == "pause")
    return {**state, "english": f"do {state['formula']}", "reached": ["bed", "tv"]}


def service(endpoint: str) -> None:
    """Ticks for ever; says `ready` when it takes requests."""
    state = {"formula": "F chair", "phase": "exploring", "paused": False}
    with open_session(ZenohConfig(endpoint=endpoint), "listen") as session:
        server = RequestServer(session, KEY, mission_verbs(prepare), partial(act, state))
        print("ready", flush=True)
        while True:
            time.sleep(0.02)
            server.serve(0)


def main(role: str, *arguments: str) -> int:
    if role == "service":
        service(*arguments)
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    args = parser.parse_args(arguments)
    try:
        return args.handler(args)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
