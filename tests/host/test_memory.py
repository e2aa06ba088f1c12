"""Memory goes back to the system: in its own process, whose heap no other test uses."""

from __future__ import annotations

import subprocess
import sys
import threading

from edge.host import memory

HOLES = """
import ctypes, os, time
from edge.host import memory
from edge.host.processes import usage

def held_mb():
    return usage(os.getpid()).memory_mb

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]
before_mb = held_mb()
blocks = [libc.malloc(100_000) for _ in range(2000)]
for block in blocks:
    ctypes.memset(block, 1, 100_000)
for block in blocks[:-1]:  # the last one keeps the heap's end where it is
    libc.free(block)
assert held_mb() > before_mb + 150.0
with memory.trim_memory_periodically(every_s=0.01):
    while held_mb() > before_mb + 50.0:
        time.sleep(0.01)
"""


def test_memory_freed_between_blocks_is_returned():
    subprocess.run([sys.executable, "-c", HOLES], check=True, timeout=240)


def trimming() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name == "memory"}


def test_the_thread_ends_with_the_block():
    with memory.trim_memory_periodically():
        assert len(trimming()) == 1
    assert trimming() == set()


def test_another_c_library_starts_no_thread(monkeypatch):
    monkeypatch.setattr(memory.ctypes, "CDLL", lambda name: object())
    with memory.trim_memory_periodically():
        assert trimming() == set()
