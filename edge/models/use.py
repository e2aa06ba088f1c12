"""`edge models use`: have the running service put another model in the place of its present one.

The service does it (`edge.perception.swap`); here it is asked for, and followed to its end.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial

from edge.bus import client, topics
from edge.bus.client import RequestError
from edge.text import one_line

_LOOK_S = 0.25
_ANSWER_S = 5.0
_WHAT = "models"
_DETECTOR_KEY = "perception.detector.model"

Ask = Callable[[dict], dict]


def run(args: argparse.Namespace) -> int:
    """Handle `edge models use NAME CONFIG`; 0 only when the model was kept.

    Raises:
        RequestError: no service is there, it does not answer, or it refuses to begin.
        ConfigError: the configuration cannot be read.
    """
    from edge.config import load

    settings = load(args.config).zenoh
    key = settings.key(topics.MODELS_REQUEST)
    until_s = time.monotonic() + args.timeout
    state = ""
    with client.connect(settings, args.timeout, _WHAT) as session:
        ask = partial(client.ask, session, key, timeout_s=_ANSWER_S, what=_WHAT)
        for swap in follow(ask, args.name, args.force, lambda: time.monotonic() < until_s):
            state = swap["state"]
            print(one_line(": ".join(filter(None, (state, swap["detail"]))), 1000), flush=True)
    if state == "kept":
        print(
            f"until the service stops; for good: {swap.get('key', _DETECTOR_KEY)}: {args.name} "
            f"in {args.config}"
        )
    return 0 if state == "kept" else 1


def follow(
    ask: Ask, name: str, force: bool, patient: Callable[[], bool], pause_s: float = _LOOK_S
) -> Iterator[dict]:
    """Ask for a swap; how it stands, whenever that has changed, until it is over.

    Args:
        ask: asks the service for something.
        patient: whether to wait on.

    Raises:
        RequestError: see `edge.bus.client.ask`; or it took too long, or another swap came after it.
    """
    swap = ask({"do": "use", "model": name, "force": force})
    number, told = swap["number"], None
    while True:
        if swap["number"] != number:
            raise RequestError(
                f"{_WHAT}: another swap has begun since; the service's log knows more"
            )
        if (told_now := (swap["state"], swap["detail"])) != told:
            told = told_now
            yield swap
        if swap["state"] in ("kept", "rolled back", "refused"):
            return
        if not patient():
            progress = f" ({swap['progress']})" if swap["progress"] else ""
            raise RequestError(
                f"{_WHAT}: still {swap['state']}{progress}, not waited for any longer; "
                "the service goes on with it and says in its log how it ends"
            )
        time.sleep(pause_s)
        swap = ask({"do": "status"})
