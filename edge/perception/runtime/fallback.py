"""A model on this computer that answers while the model on a server does not."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from edge.errors import UserError
from edge.host.backoff import pause_after
from edge.host.worker import LONGEST_ERROR, Worker
from edge.text import one_line

log = logging.getLogger(__name__)

LONGEST_WAIT_S = 1.5
"""A server that has not answered after this time counts as failed, so that the model on this
computer answers within 2 s."""
PAUSE_S, MAX_PAUSE_S = 1.0, 30.0  # before the server is asked again
STEADY_S = 60.0  # a server that answered for longer than this begins with `PAUSE_S` again

Item = TypeVar("Item")
Result = TypeVar("Result")


class FallbackModel(Generic[Item, Result]):
    """Asks a model on a server; while it gives no usable answer, a model on this computer.

    The item for which the server fails is answered here, too. From then on the server is asked
    again in the background, with newer items, and gets the items again after its first answer.

    Args:
        kind: what the models are, for the log.
        ask_server: returns the server's answer; a UserError means that it gave none.
        hold: called before an item is given to the background.
        release: called when the background is done with it.
        clock: returns the time in seconds.

    Attributes:
        detail: reason why the local model answers, one line; "" while the server answers.
    """

    def __init__(
        self,
        kind: str,
        server: str,
        local: str,
        ask_server: Callable[[Item], Result],
        hold: Callable[[Item], Any] = lambda item: None,
        release: Callable[[Item], Any] = lambda item: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.detail = ""
        self._kind, self._server, self._local = kind, server, local
        self._ask_server, self._hold, self._release = ask_server, hold, release
        self._clock = clock
        self._failures = 0  # in a row, each without a steady time before it
        self._next_s = 0.0  # the server is not asked again before this time
        self._answers_since_s = clock()
        self._background: Worker[Item, None] = Worker(
            f"{kind} of the server", self._ask_again, drop=release
        )

    def ask(self, item: Item, ask_local: Callable[[], Result]) -> Result:
        """Return the answer of the server, or of `ask_local` while the server fails.

        Raises:
            Exception: what `ask_local` raises, and what the server's model raises apart from
                UserError.
        """
        if not self.detail:
            try:
                return self._ask_server(item)
            except UserError as error:
                self._record_failure(error)
        elif self._clock() >= self._next_s and self._background.idle:
            self._hold(item)
            self._background.submit(item)
        return ask_local()

    def close(self) -> None:
        """Stop asking; the caller has aborted the server's current answer."""
        self._background.close()

    def _record_failure(self, error: UserError) -> None:
        now_s = self._clock()
        steady = now_s - self._answers_since_s > STEADY_S
        self._failures = 1 if steady else self._failures + 1
        self._next_s = now_s + pause_after(self._failures, PAUSE_S, MAX_PAUSE_S)
        self.detail = one_line(
            f"{self._local} answers until {self._server} does again: {error}", LONGEST_ERROR
        )
        log.warning("%s: %s", self._kind, self.detail)

    def _ask_again(self, item: Item) -> None:
        """Ask the server in the background; if it answers, it gets the next item."""
        try:
            self._ask_server(item)
        except Exception as error:
            self._next_s = self._clock() + PAUSE_S
            if not isinstance(error, UserError):  # the worker counts and logs it
                raise
            return
        finally:
            self._release(item)
        self._answers_since_s, self.detail = self._clock(), ""
        log.info("%s: %s answers again", self._kind, self._server)
