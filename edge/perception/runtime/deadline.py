"""How long a model that chooses directions may run (`perception.choice.time_limit_s`)."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import reason_of

FIRST_RUN_S = 600.0
_NO_MEMORY = ("allocate memory", "bad_alloc", "bad allocation", "out of memory")


class Deadline:
    """A time limit for runs of sessions, which break off when it passes or when they are told to.

    Attributes:
        options: to be given to `session.run`.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._ended = False
        self.options: Any = None

    @contextmanager
    def within(self, seconds: float) -> Iterator[None]:
        """Break off what runs in this block after so long.

        Raises:
            ModelError: it was broken off, or failed; one line.
        """
        import onnxruntime as ort

        self.options = options = ort.RunOptions()
        # What is not asked for is not computed: logits, where only keys and values are wanted.
        options.only_execute_path_to_fetches = True
        options.log_severity_level = 4  # what fails is told once, by what is raised
        options.terminate = self._ended  # `end` may have come before
        timer = threading.Timer(seconds, setattr, (options, "terminate", True))
        timer.daemon = True
        timer.start()
        try:
            yield
        except ModelError:
            raise
        except Exception as error:  # onnxruntime raises many types of its own
            text = str(error)
            if self._ended:
                why = "given up: it was told to end"
            elif options.terminate:
                why = f"no answer within {seconds:g} s (perception.choice.time_limit_s)"
            elif isinstance(error, MemoryError) or any(s in text.lower() for s in _NO_MEMORY):
                why = f"out of memory ({reason_of(error)}): take a smaller variant"
            else:
                why = f"it fails: {reason_of(error)}"
            raise ModelError(f"model {self._name}: {why}") from None
        finally:
            timer.cancel()

    def end(self) -> None:
        """Break off what runs and whatever would run; for any thread."""
        self._ended = True
        if self.options is not None:
            self.options.terminate = True
