"""A model process for tests: the first pixel of an image steers its detector.

Started in place of `edge.perception.serve_detector`. While the file `detector.vocabulary` names
says `wait` or `build` it is not ready; what else the file says keeps it from loading.
"""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime
from onnx_bytes import FLOAT, INT64, graph, interface, model, node

from edge.perception import serve_detector as serve
from edge.perception.embedding.text import PromptError
from edge.perception.process import wire
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import ModelHealth
from edge.types import ContextBoxes, Detections

NO_CONTEXT = ContextBoxes(
    np.empty((0, 4), np.float32), np.empty(0, np.float32), np.empty(0, np.int32), ()
)
SEGFAULT, HANG, NO_MEMORY, NAN, FAILURE, EXIT, ENGINE, TOO_MANY = range(1, 9)


def fail(error: BaseException) -> None:
    raise error


def hungry() -> onnxruntime.InferenceSession:
    """Return a model that allocates as many zeros as it is asked for."""
    ends = {"inputs": {"x": (INT64, (1,))}, "outputs": {"y": (FLOAT, None)}}
    return onnxruntime.InferenceSession(
        model(graph(interface(**ends), (node("ConstantOfShape"),))),
        providers=["CPUExecutionProvider"],
    )


ORDERS = {
    SEGFAULT: lambda: os.kill(os.getpid(), signal.SIGSEGV),
    HANG: signal.pause,
    NO_MEMORY: lambda: hungry().run(None, {"x": np.array([1 << 45], np.int64)}),
    FAILURE: lambda: fail(RuntimeError("no luck\nat all")),
    EXIT: lambda: os._exit(3),
}


class Steered:
    """Stand-in detector: the entire image once for each prompt, with its mean as the score.

    It adds seven unsound boxes if its settings say so for the images so far.
    """

    name = "steered"
    invalid_boxes = 0

    def __init__(self, prompts):
        self._started = False
        self.set_prompts(prompts)
        self._health, self._started = ModelHealth(), True

    def set_prompts(self, prompts):
        if "nonsense" in prompts:
            raise PromptError("prompt 'nonsense': not in the vocabulary")
        if "slow" in prompts and self._started:
            raise TimeoutError("such prompts take longer than an image")
        self.prompts = tuple(prompts)

    def detect(self, observation):
        height, width = observation.rgb.shape[:2]
        self.invalid_boxes = 7
        order, n = int(observation.rgb[0, 0, 0]), len(self.prompts)
        if order == TOO_MANY:  # a box takes more than a byte
            n = wire.MAX_BYTES
        ORDERS.get(order, lambda: None)()
        self._health = (
            ModelHealth("building engine", "3 of 9") if order == ENGINE else ModelHealth()
        )
        right = np.nan if order == NAN else width
        return Detections(
            observation=observation,
            xyxy_px=np.tile(np.array([[0, 0, right, height]], np.float32), (n, 1)),
            score=np.full(n, observation.rgb.mean(dtype=np.float64) / 255, np.float32),
            class_id=np.arange(n, dtype=np.int32) % len(self.prompts),
            prompts=self.prompts,
            competing_score=np.zeros(n, np.float32),
            context=NO_CONTEXT,
        )

    def health(self):
        return self._health


def make(perception, prompts, progress):
    script = Path(perception.detector.vocabulary or os.devnull)
    if script.read_text() == "build":
        progress(ModelHealth("building engine", "1 of 2"))
    while (said := script.read_text()) in ("wait", "build"):
        time.sleep(0.01)
    if said == "exit":
        os._exit(4)
    if said:
        raise ModelError(said)
    return Steered(prompts)


if __name__ == "__main__":
    atexit.register(gc.freeze)  # as `edge.host.children` does
    sys.exit(serve.main(make))
