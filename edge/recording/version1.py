"""Version 1 of the journal: converts its old names, so that old recordings can be replayed."""

from __future__ import annotations

from typing import Any

KINDS = {"asked": "request", "found": "result", "decided": "decision", "answer": "goal_status"}
WORKERS = {"prior": "rooms", "surveyor": "travel_cost"}
FIELDS = {
    "decided": {"what": "name", "said": "value"},
    "found": {"what": "result"},
    "start": {"saved": "mission_checkpoint", "places": "map_checkpoint"},
}
"""Old name → new name: of the kinds of entries, of the workers, and of the fields by old kind."""
GOAL_KINDS = {"look": "spin"}
"""Old kind of a goal → new kind."""


def present_page(page: dict[str, Any]) -> dict[str, Any]:
    """Return a page of the journal, as JSON, with the present names; change it in place."""
    if "said" not in page:  # the old name of `decisions`, so this page is not old
        return page
    page["decisions"] = decisions = page.pop("said")
    page["entries"] = [_present_entry(entry) for entry in page["entries"]]
    for goal in () if decisions is None else (decisions["goal"], *decisions["sent"]):
        if goal is not None:
            goal["kind"] = GOAL_KINDS.get(goal["kind"], goal["kind"])
    return page


def _present_entry(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry with the present names."""
    kind, fields = entry["kind"], FIELDS.get(entry["kind"], {})
    entry = {fields.get(name, name): value for name, value in entry.items()}
    entry["kind"] = KINDS.get(kind, kind)
    if "worker" in entry:
        entry["worker"] = WORKERS.get(entry["worker"], entry["worker"])
    if entry.get("worker") == "detector" and kind == "found" and "rival" in entry["result"]:
        entry["result"]["competing_score"] = entry["result"].pop("rival")
    return entry
