"""What can be held of the service, from outside."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from edge.errors import UserError

if TYPE_CHECKING:
    from edge.lab.eval.soak.stage import Stage
    from edge.lab.eval.soak.watch import Watch


class When(NamedTuple):
    """A fault's time (`time.monotonic`, in seconds); one that lasts ends when it begins."""

    began_s: float
    ended_s: float


Hold = Callable[["Stage", "Watch", When], str]
"""Why something does not hold; empty where it does."""

LIVE_PAGES = ("/live/now", "/live/story", "/live/map", "/live/camera", "/live/layers/0")
"""What the live page asks for while it is open."""
_OF_USUAL = 0.5  # a beat that is back, on a machine that has other work as well


def recovered(stage: Stage, watch: Watch, when: When) -> str:
    """`/readyz` is 200 and ticks come half as often as before, or more."""
    if watch.seen_s <= when.ended_s or not watch.is_ready:
        return f"not ready: {'; '.join(watch.ready) or 'not asked yet'}"
    ticks_hz, usual_hz = watch.ticks_hz(when.ended_s), watch.usual_hz
    if ticks_hz < _OF_USUAL * usual_hz:
        return f"{ticks_hz:.1f} ticks a second, {usual_hz:.1f} before"
    return ""


def blind(stage: Stage, watch: Watch, when: When) -> str:
    """`/readyz` says that nothing is to be seen."""
    if watch.seen_s > when.began_s and any("no usable observations" in why for why in watch.ready):
        return ""
    return f"does not say that nothing is to be seen, but: {'; '.join(watch.ready) or 'ready'}"


def says(pattern: str) -> Hold:
    """The log has a line with this."""

    def hold(stage: Stage, watch: Watch, when: When) -> str:
        if any(re.search(pattern, line) for line in stage.log.since(when.began_s)):
            return ""
        return f"the log does not say {pattern!r}"

    hold.__doc__ = f"the log says `{pattern}`"
    return hold


def checkpoint_fails(stage: Stage, watch: Watch, when: When) -> str:
    """status says that the checkpoint is not written."""
    told = watch.status.get("checkpoint") or {}
    if watch.status_s > when.began_s and told.get("problem"):
        return ""
    return "status says nothing of a checkpoint that is not written"


def checkpoint_written(stage: Stage, watch: Watch, when: When) -> str:
    """the checkpoint is written again."""
    told = watch.status.get("checkpoint") or {}
    if watch.status_s > when.ended_s and not told.get("problem"):
        return ""
    return f"the checkpoint is not written: {told.get('problem')}"


def recording_fails(stage: Stage, watch: Watch, when: When) -> str:
    """status says that nothing is recorded."""
    if all(told["problem"] for told in _recorders(watch)) and watch.status_s > when.began_s:
        return ""
    return "status says nothing of a recording that cannot be written"


def recording_goes_on(stage: Stage, watch: Watch, when: When) -> str:
    """recording goes on."""
    if watch.status_s <= when.ended_s:
        return "status was not heard since"
    stopped = [told for told in _recorders(watch) if told["problem"] or not told["file"]]
    return f"nothing is recorded: {stopped[0]['problem']}" if stopped else ""


def _recorders(watch: Watch) -> list[dict[str, Any]]:
    """What the sinks that write files say of themselves; none where none records."""
    return [told for told in (watch.status.get("sinks") or {}).values() if "file" in told]


def page_answers(stage: Stage, watch: Watch, when: When) -> str:
    """the live page is served."""
    silent = [path for path in LIVE_PAGES if not stage.text(path)]
    return f"{silent[0]}: no answer" if silent else ""


def answers(stage: Stage, watch: Watch, when: When) -> str:
    """a request is answered."""
    try:
        stage.mission(do="status")
    except UserError as error:
        return str(error)
    return ""
