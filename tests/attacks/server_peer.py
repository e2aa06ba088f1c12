"""A server of the package's small detector as a process: `python server_peer.py PORT`, for KServe.

It prints `ready`.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import onnxruntime
from kserve_server import KServe, serving

from edge.perception.runtime.cards import load_card

MODEL = "mini-house-256x320-int8-cpu"


def main(port: int) -> None:
    session = onnxruntime.InferenceSession(str(load_card(MODEL).path))

    def run(feed):
        return dict(zip(("boxes", "scores"), session.run(["boxes", "scores"], feed), strict=True))

    with serving(KServe(run), port):
        print("ready", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main(int(sys.argv[1]))
