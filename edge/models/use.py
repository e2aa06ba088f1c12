"""`edge models use`: requests a switch of the model from the running service, and follows it.

The service does the switch (`edge.perception.swap`).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial

from edge.bus import client, topics
from edge.bus.client import RequestError
from edge.text import one_line

_PERIOD_S = 0.25  # pause between two requests of the state
_ANSWER_S = 5.0  # time limit of one request
_WHAT = "models"  # beginning of error messages
_DETECTOR_KEY = "perception.detector.model"

Ask = Callable[[dict], dict]
"""Sends a request to the service and returns its answer."""


def run(args: argparse.Namespace) -> int:
    """Handle `edge models use NAME CONFIG`; return 0 only if the new model was kept.

    Raises:
        RequestError: no service is running, it does not answer, or it refuses.
        ConfigError: the configuration cannot be read.
    """
    from edge.config import load

    settings = load(args.config).zenoh
    key = settings.key(topics.MODELS_REQUEST)
    deadline_s = time.monotonic() + args.timeout
    state = ""
    with client.connect(settings, args.timeout, _WHAT) as session:
        ask = partial(client.send_request, session, key, timeout_s=_ANSWER_S, what=_WHAT)
        for swap in follow_swap(ask, args.name, args.force, lambda: time.monotonic() < deadline_s):
            state = swap["state"]
            print(one_line(": ".join(filter(None, (state, swap["detail"]))), 1000), flush=True)
    if state == "kept":
        print(
            f"valid until the service stops; to keep it, set {swap.get('key', _DETECTOR_KEY)}: "
            f"{args.name} in {args.config}"
        )
    return 0 if state == "kept" else 1


def follow_swap(
    ask: Ask, name: str, force: bool, is_patient: Callable[[], bool], pause_s: float = _PERIOD_S
) -> Iterator[dict]:
    """Request a swap, and yield its state at every change until it has ended.

    Args:
        ask: sends a request to the service and returns its answer.
        name: name of the new model.
        force: True: accept a model that is too slow or finds too few boxes.
        is_patient: returns False when the caller does not want to wait any longer.
        pause_s: pause between two requests of the state.

    Raises:
        RequestError: the service does not answer or refuses, the swap took too long, or another
            swap has begun.
    """
    swap = ask({"do": "use", "model": name, "force": force})
    number, last = swap["number"], None
    while True:
        if swap["number"] != number:
            raise RequestError(
                f"{_WHAT}: another swap began before this one ended; see the log of the service"
            )
        if (now := (swap["state"], swap["detail"])) != last:
            last = now
            yield swap
        if swap["state"] in ("kept", "rolled back", "refused"):
            return
        if not is_patient():
            progress = f", {swap['progress']}" if swap["progress"] else ""
            raise RequestError(
                f"{_WHAT}: the change to {name} is not finished within --timeout (state: "
                f"{swap['state']}{progress}); the service goes on with the change: see its log for "
                "the result"
            )
        time.sleep(pause_s)
        swap = ask({"do": "status"})
