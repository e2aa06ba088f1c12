"""A recording as a robot's user has it: of a real process that is killed in its mission."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from edge_processes import write_config

from edge.recording.channels import JOURNAL
from edge.recording.file import PARTIAL, McapReader
from edge.recording.rolling import files_of


def pages(path: Path) -> int:
    return sum(m.topic == JOURNAL.topic for m in McapReader(path))


@pytest.mark.slow
def test_a_recording_cut_off_by_kill_9_replays(edge, endpoint, tmp_path):
    folder = tmp_path / "recordings"
    mcap = {"kind": "mcap", "options": {"folder": str(folder), "sync_s": 0.5}}
    config = write_config(tmp_path, zenoh={"endpoint": endpoint}, sinks=["zenoh", mcap])
    edge("sim", config)
    edge("sim", config, "--motion-only")
    run = edge("run", config).says("ready:")

    def enough(path: Path) -> bool:
        return path.stat().st_size > 1_000_000 and pages(path) > 10

    run.until(lambda: any(map(enough, files_of(folder))))
    (left,) = files_of(folder)
    before = tmp_path / "before.mcap"
    before.write_bytes(left.read_bytes())
    run.until(lambda: left.stat().st_size > before.stat().st_size)
    run.kill()
    assert left.name.endswith(PARTIAL)
    there = pages(left)
    assert there >= pages(before)

    recovered = edge("replay", left, "--recover")
    assert recovered.wait() == os.EX_OK, recovered.output
    whole = left.with_name(left.name.removesuffix(PARTIAL))
    assert pages(whole) == there
    left.unlink()  # otherwise it would be a part of the run too
    replayed = edge("replay", whole)
    assert replayed.wait() == os.EX_OK, replayed.output
    assert "identical in every tick" in replayed.output
    ticks = int(re.search(r": (\d+) ticks", replayed.output)[1])
    assert 0.5 * there < ticks <= there
