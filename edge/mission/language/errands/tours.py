"""Rewriting of errands through several rooms or stops: tours, explorations and patrols."""

from __future__ import annotations

import re

from edge.memory import RECOGNISED_KINDS, kind_of_room
from edge.mission.language.errands import errand_patterns as patterns
from edge.mission.language.words import nouns
from edge.mission.language.words.everyday_words import (
    EACH_ROOM,
    EACH_ROOM_AND,
    NAME,
    bare,
    each_kind,
    is_room,
    is_vague,
)
from edge.mission.language.words.places import EVERY, EXPLORED, HERE, is_marked
from edge.mission.language.words.rewriting import go_to, go_to_each
from edge.mission.language.words.spans import number_of, seconds_of, shown_s
from edge.mission.language.words.templates import STOP
from edge.mission.language.words.tokens import unclear

_LEFT_OUT = " avoid"  # before rooms that a tour leaves out, at the start of the text
_JOINT = r",? (?:and then|and|then|or) |, "  # between the stops of an exploration


def rewrite_all_but(found: re.Match[str]) -> str | None:
    """Return "explore the house except the bathroom" with the ban first.

    None if the first name is no room, or another one is unknown.
    """
    for number, name in enumerate(map(bare, re.split(r",? (?:and|or) |, ", found["left_out"]))):
        known = is_marked(name) or kind_of_room(name) in RECOGNISED_KINDS
        if known or re.fullmatch(r"room \w+", name):
            continue
        if is_room(name):
            raise unclear(name, "no room has this name; give a room this name first")
        if number == 0 or nouns.unknown_in(name.split()) is not None:
            return None
    return f"{_LEFT_OUT} {found['left_out']}.{found['lead']}{found['order']}"


def rewrite_every_room(found: re.Match[str]) -> str | None:
    """Return "visit all bedrooms" as `go to "every bedroom"`; None to explore all rooms."""
    kind = each_kind(found["each"])
    explores = re.search(r"\b(?:explor|scan|map|survey)", found[0], re.I)
    is_ban = re.search(r"\b(?:not|never)$", found.string[: found.start()], re.I)
    if is_ban or (kind == "room" and explores):
        return None
    rest = found[0][found.end("each") - found.start() :]
    if work := patterns.IN_EACH.match(rest + found.string[found.end() :]):
        hint = "the robot goes into each room and looks around; it can do no more there"
        raise unclear(work[0], hint)
    is_next = found.start() and re.match(r",| (?:and|then|so|but)\b", found[0], re.I)
    return go_to(_tour_of(found), found if is_next else None)


def rewrite_every_room_too(found: re.Match[str]) -> str | None:
    """Return "and every bathroom", after another stop, as an order."""
    sentence = re.split(r"[.;!?]", found.string[: found.start()])[-1]
    return None if patterns.BAN.search(sentence) else go_to(_tour_of(found), found)


def _tour_of(found: re.Match[str]) -> str:
    """Return the proposition of a tour: "every bedroom" for "all the bedrooms"."""
    if more := EACH_ROOM_AND.match(found.string, found.end("each")):
        part = f"{found['each'].strip()}{more[0]}"
        hint = "unclear if this means every one of them; say 'every' before each kind of room"
        raise unclear(part, hint)
    return f"{EVERY} {each_kind(found['each'])}"


def refuse_other_tours(text: str) -> None:
    """Refuse several rooms that no rule has read; a ban may name them."""
    for sentence in re.split(r"[.;!?]", re.sub(r'"[^"]*"', '""', text)):
        found = re.search(rf"\b{EACH_ROOM}\b", sentence, re.I)
        if found and not patterns.BAN.search(sentence):
            hint = f"a tour cannot stand here; say 'go into {found[0]}' in a sentence of its own"
            raise unclear(found[0], hint)


def rewrite_exploration(found: re.Match[str]) -> str | None:
    """Return "explore the kitchen and the hall" as orders to go to `explored …`."""
    slots = found.groupdict()
    time = _for_duration(slots.get("span"))
    # Rooms, and the words between them; "" stands for the entire site.
    joints = re.findall(_JOINT, slots.get("stops") or "")
    rooms = [bare(stop) for stop in re.split(_JOINT, slots.get("stops") or slots.get("room") or "")]
    rooms = ["" if re.fullmatch(r"(?:every|each|all) rooms?", room) else room for room in rooms]
    if not all(is_room(room) for room in rooms if room) or (time and len(rooms) > 1):
        return None
    if vague := [room for room in rooms if room and is_vague(room)]:
        raise unclear(vague[0], "unclear which room; name it")
    orders = [go_to(f"{EXPLORED}{f' {room}' * bool(room)}{time}") for room in rooms]
    return orders[0] + "".join(
        j.rstrip() + order for j, order in zip(joints, orders[1:], strict=True)
    )


def rewrite_exploration_here(found: re.Match[str]) -> str | None:
    """Return the order to explore the entire site, or the room that the text before goes to."""
    room, before = "", found.string[: found.start()]
    if before:
        last = re.search(rf"(?:to|in|into) (?P<name>{NAME}),?$", before, re.I)
        if last is None or not is_room(bare(last["name"])):
            raise unclear(found[0], "unclear where; name the room")
        room = f" {bare(last['name'])}"
    return go_to(f"{EXPLORED}{room}{_for_duration(found['span'])}", found)


def _for_duration(span: str | None) -> str:
    return f" for {shown_s(seconds_of(span))}" if span else ""


def rewrite_patrol(found: re.Match[str]) -> str | None:
    """Return a patrol as the stops of all its rounds, or as one round with "repeat …".

    Return None if it is no patrol.
    """
    slots = found.groupdict()
    before, after = found.string[: found.start()], found.string[found.end() :].strip(" .!?")
    before = re.sub(rf"^{_LEFT_OUT} [^.]*\.$", "", before)
    if re.search(r"\b(?:not|never|stop)$", before, re.I):
        return None
    if slots.get("stops") is None:
        kind = each_kind(slots["each"]) if slots.get("each") else "room"
        stops = [f'"{EVERY} {kind}"']
    else:
        stops = [bare(stop) for stop in re.split(STOP, slots["stops"])]
        if re.search(r"\bor\b", slots["stops"]) or any(map(is_vague, stops)) or len(stops) < 2:
            return None
    often = (slots.get("count") or slots.get("often") or "").lower()
    rounds = number_of(often) if often else None
    if often and rounds is None:
        return None
    if rounds and rounds <= patterns.MAX_ROUNDS and (len(stops) > 1 or rounds == 1):
        return go_to_each(stops * rounds)
    if before or after:
        hint = (
            "this cannot go with a patrol of rooms, for some time, without an end or with more "
            f"than {patterns.MAX_ROUNDS} rounds; send the patrol alone"
        )
        if begin := re.search(r" wait until (?P<clock>\S+ \wm), then$", before):
            hint = (
                "say 'every day at …' or 'visit every room': a patrol without an end begins at once"
            )
            raise unclear(f"at {begin['clock']}", hint)
        raise unclear(before.strip() or after, hint)
    end = f"{rounds} times" if rounds is not None else "until told"
    end = f"for {shown_s(seconds_of(slots['span']))}" if slots.get("span") else end
    return f"{go_to_each(stops)}; repeat {end}"


def rewrite_errand_and_back(found: re.Match[str]) -> str | None:
    """Return "go to the door and back, three times" as a sequence of stops."""
    slots = found.groupdict()
    times = number_of((slots.get("count") or slots.get("often") or "").lower())
    if times is None or not 1 <= times <= patterns.MAX_ROUNDS:
        return None
    return go_to_each([bare(found["object"]), f'"{HERE}"'] * times)


def rewrite_list_in_turn(found: re.Match[str]) -> str | None:
    """Return a list of stops that comes back to one as a sequence: "kitchen, hall, kitchen"."""
    stops = [bare(stop) for stop in re.split(STOP, found["stops"])]
    if len(set(stops)) == len(stops) or re.search(r"\bor\b", found["stops"]):
        return None
    return go_to_each(stops)
