"""`edge demo --live`: the page of a real run, from its start to its end, with commands."""

from __future__ import annotations

import re
import signal

import pytest
from chromium import open_chromium

TOKEN = "a-token-of-the-tests"


@pytest.mark.slow
def test_the_demo_is_watched_and_commanded_from_its_page(edge, tmp_path):
    file = tmp_path / "token"
    file.write_text(TOKEN)
    demo = edge(
        "demo", "--live", EDGE__HTTP__TOKEN_FILE=str(file), EDGE__ROBOT__MAX_SPEED_MPS="0.1"
    ).says("live view: ")
    url = re.search(r"live view: (http://127\.0\.0\.1:\d+/)", demo.output)[1]
    with open_chromium() as tab:
        tab.open(url)
        tab.until("document.getElementById('token-dialog').open")
        tab.type("#token", TOKEN)
        tab.click("#token-ok")
        tab.says("#phase", "SEARCHING")
        tab.says("#camera-note", "320 × 256")
        tab.says("#latency", "publish")
        tab.click("#pause")
        tab.says("#phase", "PAUSED")
        demo.says("mission: paused")
        tab.click("#new")
        tab.type("#words", "find the toilet")
        tab.click("#new-ok")
        tab.says("#instruction", "find the toilet")
        tab.says("#phase", "SEARCHING")
        tab.click("#cancel")
        tab.says("#cancel", "Really cancel?")
        tab.click("#cancel")
        demo.says(f"mission failed; the live view stays open until Ctrl-C: {url}")
        tab.says("#phase", "FAILED")
        assert demo.stop(signal.SIGINT) == 1, demo.output
        tab.says("#banner", "does not answer: last seen")
    assert "failed: find the toilet (cancelled)" in demo.output
