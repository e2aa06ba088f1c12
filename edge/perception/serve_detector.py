"""Program of a process that runs a detector, started by `process/link.py` only.

`edge.perception.process` describes the messages.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
import threading
from collections.abc import Callable, Sequence

import numpy as np

from edge import config
from edge.perception.detection.detector import Detector
from edge.perception.factory import make_detector
from edge.perception.process import wire
from edge.perception.process.child import as_memory_error, set_up_child
from edge.perception.process.wire import FrameView
from edge.perception.runtime.health import Health, ProgressCallback
from edge.text import read_json_object
from edge.types import Observation

log = logging.getLogger(__name__)

Make = Callable[[config.PerceptionConfig, Sequence[str], ProgressCallback], Detector]


def main(make: Make = make_detector) -> int:
    """Load the model that stdin names, and answer until the service ends this process."""
    request, images, control, frames = set_up_child()
    sending = threading.Lock()

    def progress(health: Health) -> None:  # on any thread, but only until `make` returns
        with sending:
            control.send(wire.encode(health=health))

    try:
        perception = config.PerceptionConfig.model_validate(request["perception"])
        detector = make(perception, request["prompts"], progress)
        # Compile all kernels. Else the first real image would wait, which looks like a hang.
        detector.detect(Observation(0, 0, np.eye(4), rgb=np.zeros((64, 64, 3), np.uint8)))
        detector.invalid_boxes = 0  # that image was not from a camera
    except Exception as error:
        control.send(wire.encode_error(error))
        return 1
    control.send(wire.encode())
    threading.Thread(target=check_prompts, args=(control, detector), daemon=True).start()
    try:
        answer_images(images, detector, frames)
    except BaseException:
        log.exception("model %s: its process ends after an error", detector.name)
        os._exit(1)  # `check_prompts` blocks in recv for ever
    return 0


def check_prompts(control: socket.socket, detector: Detector) -> None:
    """Answer prompt checks on `control`, while `answer_images` runs."""
    while message := control.recv(wire.MAX_BYTES):
        request = read_json_object(message)
        try:
            detector.set_prompts(request["prompts"])
            control.send(wire.encode(id=request["id"]))
        except Exception as error:
            control.send(wire.encode_error(error, id=request["id"]))


def answer_images(images: socket.socket, detector: Detector, frames: FrameView) -> None:
    """Answer every image with its detections, or with the error that was raised."""
    while message := images.recv(wire.MAX_BYTES):
        request = read_json_object(message)
        seq, prompts = request["seq"], tuple(request["prompts"])
        try:
            if prompts != detector.prompts:
                detector.set_prompts(prompts)
            rgb = frames.read(seq, request["hw"])
            found = detector.detect(Observation(seq, 0, np.eye(4), rgb=rgb))
            if not frames.is_intact(seq):
                raise ValueError(f"frame {seq}: overwritten by a newer frame")
        except Exception as error:
            images.send(wire.encode_error(as_memory_error(error), seq=seq))
        else:
            health, invalid = detector.health(), detector.invalid_boxes
            images.send(wire.encode_answer(seq, found, health, invalid))


if __name__ == "__main__":
    sys.exit(main())
