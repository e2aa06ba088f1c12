"""A server of models as a process: `python server_peer.py PORT`, for KServe and for chats at once.

It has the small detector of the package, and a chat model that always says the same. It prints
`ready`.
"""

from __future__ import annotations

import json
import math
import sys
import threading
from http.server import BaseHTTPRequestHandler
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import onnxruntime
from chat_server import completion, likeliest, send
from http_server import running
from kserve_server import Handler, KServe

from edge.perception.runtime.cards import load_card

FORMULA = "F bed"
MODEL = "mini-house-256x320-int8-cpu"


def chat(handler: BaseHTTPRequestHandler, asked: dict) -> None:
    """Answer the translator with a formula, and a choice scorer with A and Yes."""
    if "logprobs" not in asked:
        send(handler, completion(FORMULA))
        return
    is_scene = "Yes" in json.dumps(asked)
    send(handler, likeliest({"Yes" if is_scene else "A": math.log(0.97)}))


def main(port: int) -> None:
    session = onnxruntime.InferenceSession(str(load_card(MODEL).path))

    def run(feed):
        return dict(zip(("boxes", "scores"), session.run(["boxes", "scores"], feed), strict=True))

    class Both(Handler):
        kserve = KServe(run)

        def do_POST(self) -> None:
            if "/chat/" not in self.path:
                super().do_POST()
                return
            chat(self, json.loads(self.rfile.read(int(self.headers["Content-Length"]))))

    with running(Both, threading.Event(), port):
        print("ready", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main(int(sys.argv[1]))
