"""Actions of the commands that send requests to a running service.

Light to import, so that the command line can take its arguments from here.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from edge.cli.options import config_argument, lazy_handler

ANSWER_S = 5.0
"""Default time for the connection, and for each answer."""


def add_action(actions: Any, name: str, text: str, module: str) -> argparse.ArgumentParser:
    """Add an action that takes a configuration, and return its parser."""
    action: argparse.ArgumentParser = actions.add_parser(name, help=text)
    config_argument(action)
    action.set_defaults(handler=lazy_handler(module))
    return action


@contextmanager
def connected(
    config: str, patience_s: float = ANSWER_S, what: str = "service"
) -> Iterator[Callable[..., dict]]:
    """Connect to the service of a configuration; yield `ask(topic, request)`.

    Raises:
        RequestError: no service is there, it does not answer, or it refuses.
        ConfigError: the configuration cannot be read.
    """
    from edge.bus import client
    from edge.config import load

    settings = load(config).zenoh
    with client.connect(settings, patience_s, what) as session:

        def ask(topic: Any, request: dict) -> dict:
            return client.send_request(session, settings.key(topic), request, patience_s, what)

        yield ask
