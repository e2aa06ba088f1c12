"""Program of a process that runs a detector, started by `process/link.py` only.

`edge.perception.process` describes the messages.
"""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from edge import config
from edge.perception.detection.detector import Detector
from edge.perception.factory import make_detector
from edge.perception.process import wire
from edge.perception.process.child import Answer, run_child
from edge.perception.process.wire import FrameView
from edge.perception.runtime.health import ModelHealth, ProgressCallback
from edge.text import read_json_object
from edge.types import Observation

Make = Callable[[config.PerceptionConfig, Sequence[str], ProgressCallback], Detector]


def main(make: Make = make_detector) -> int:
    """Load the model that stdin names, and answer until the service ends this process."""

    def load(request: dict[str, Any], control: socket.socket) -> Answer:
        sending = threading.Lock()

        def progress(health: ModelHealth) -> None:  # on any thread, but only until `make` returns
            with sending:
                control.send(wire.encode(health=health))

        perception = config.PerceptionConfig.model_validate(request["perception"])
        detector = make(perception, request["prompts"], progress)
        # Compile all kernels. Else the first real image would wait, which looks like a hang.
        detector.detect(Observation(0, 0, np.eye(4), rgb=np.zeros((64, 64, 3), np.uint8)))
        detector.invalid_boxes = 0  # that image was not from a camera
        threading.Thread(target=check_prompts, args=(control, detector), daemon=True).start()
        return partial(answer_image, detector)

    return run_child(load)


def check_prompts(control: socket.socket, detector: Detector) -> None:
    """Answer prompt checks on `control`, while `answer_image` runs."""
    while message := control.recv(wire.MAX_BYTES):
        request = read_json_object(message)
        try:
            detector.set_prompts(request["prompts"])
            control.send(wire.encode(id=request["id"]))
        except Exception as error:
            control.send(wire.encode_error(error, id=request["id"]))


def answer_image(detector: Detector, request: dict[str, Any], frames: FrameView) -> bytes:
    """Return the detections of an image, encoded."""
    seq, prompts = request["seq"], tuple(request["prompts"])
    if prompts != detector.prompts:
        detector.set_prompts(prompts)
    rgb = frames.read(seq, request["hw"])
    found = detector.detect(Observation(seq, 0, np.eye(4), rgb=rgb))
    if not frames.is_intact(seq):
        raise ValueError(f"frame {seq}: overwritten by a newer frame")
    return wire.encode_answer(seq, found, detector.health(), detector.invalid_boxes)


if __name__ == "__main__":
    sys.exit(main())
