"""Time limit for runs of models for frontier selection (`perception.choice.time_limit_s`)."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from edge.perception.runtime.health import is_out_of_memory
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import short_reason

FIRST_RUN_S = 600.0
"""Time limit for a model's first run, which may build engines; for callers of `within`."""


class InferenceTimeout:
    """A time limit for session runs. A run aborts when the time is over, or when `end` is called.

    Attributes:
        options: pass them to `session.run`.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._ended = False
        self.options: Any = None

    @contextmanager
    def within(self, seconds: float) -> Iterator[None]:
        """Abort session runs in this block after this time.

        Raises:
            ModelError: a run was aborted, or failed; one line.
        """
        import onnxruntime as ort

        self.options = options = ort.RunOptions()
        # Compute only the requested outputs: no logits if only keys and values are needed.
        options.only_execute_path_to_fetches = True
        options.log_severity_level = 4  # the exception already reports a failure
        options.terminate = self._ended  # `end` may have been called before
        timer = threading.Timer(seconds, setattr, (options, "terminate", True))
        timer.daemon = True
        timer.start()
        try:
            yield
        except ModelError:
            raise
        except Exception as error:  # onnxruntime raises many types
            if self._ended:
                why = "aborted: the model was closed"
            elif options.terminate:
                why = f"no answer within {seconds:g} s (perception.choice.time_limit_s)"
            elif is_out_of_memory(error):
                why = f"out of memory ({short_reason(error)}): take a smaller variant"
            else:
                why = f"it fails: {short_reason(error)}"
            raise ModelError(f"model {self._name}: {why}") from None
        finally:
            timer.cancel()

    def end(self) -> None:
        """Abort the current run and all later ones; for any thread."""
        self._ended = True
        if self.options is not None:
            self.options.terminate = True
