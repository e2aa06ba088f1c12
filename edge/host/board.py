"""Readings of the board: temperatures, throttling, power and memory, from files of Linux.

Every Linux has some of these files; a Jetson with JetPack 6 or 7 has all. If a file is missing, has
invalid content, or cannot be read (the sensor's part is switched off), only its value is missing.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from edge.host.machine import power_mode_of, text_of
from edge.text import one_line

_COLDEST_C, _HOTTEST_C = -100.0, 300.0  # a Jetson's sensors without power read -256
_TRIP_KINDS = ("passive", "hot", "critical")
_OVER_CURRENT = "soctherm_oc"  # name of the chip that counts over-currents
_MAX_NAME_CHARS = 60


@dataclass(frozen=True, slots=True)
class BoardReading:
    """All values that could be read.

    Attributes:
        temperature_c: thermal zone → temperature in °C.
        trip_c: (zone, kind) → trip temperature in °C; kinds are `passive` (throttling), `hot` and
            `critical` (shutdown).
        throttled: cooling device → throttling, from 0 (none) to 1; without fans.
        over_current: alarm (`oc1` …) → number of times that a Jetson throttled since its start,
            because it drew too much current.
        power_w: rail (a supply line of the board) → power in watts.
        memory_bytes: `total` and `available` memory of the computer.
        power_mode: name of a Jetson's power mode.
    """

    temperature_c: Mapping[str, float]
    trip_c: Mapping[tuple[str, str], float]
    throttled: Mapping[str, float]
    over_current: Mapping[str, int]
    power_w: Mapping[str, float]
    memory_bytes: Mapping[str, int]
    power_mode: str | None


def read_board(root: Path = Path("/")) -> BoardReading:
    """Read the present values of the board.

    Args:
        root: folder with `proc`, `sys`, `etc` and `var`.

    Example:
        >>> board = read_board()
        >>> sorted(board.memory_bytes)
        ['available', 'total']
    """
    thermal, hwmon = root / "sys/class/thermal", root / "sys/class/hwmon"
    return BoardReading(
        _highest(_temperatures(thermal)),
        _trip_points(thermal),
        _highest(_throttling(thermal)),
        dict(_over_current(hwmon)),
        _highest(_power(hwmon)),
        dict(_memory(text_of(root / "proc/meminfo"))),
        power_mode_of(root),
    )


def throttling_reason(
    board: BoardReading, before: BoardReading | None = None, margin_c: float = 0.0
) -> str:
    """Return why the board throttles or soon will throttle, in a few words; "" if there is no sign.

    Args:
        board: present values.
        before: earlier values; only over-currents since then count.
        margin_c: distance of a zone to its trip temperature that counts as reached.
    """
    for device, share in board.throttled.items():
        if share > 0.0:
            return f"{device} is throttled by {share:.0%}"
    for alarm, events in board.over_current.items():
        if before is not None and events > before.over_current.get(alarm, events):
            return f"the board throttles, it draws too much current ({alarm})"
    for (zone, kind), trip_c in board.trip_c.items():
        celsius = board.temperature_c.get(zone)
        if celsius is not None and celsius >= trip_c - margin_c:
            return f"{zone} is at {celsius:.0f} C, {kind} from {trip_c:.0f} C"
    return ""


def _temperatures(thermal: Path) -> Iterator[tuple[str, float]]:
    for zone in thermal.glob("thermal_zone*"):
        celsius = _read_celsius(zone / "temp")
        if celsius is not None:
            yield _read_name(zone / "type"), celsius


def _trip_points(thermal: Path) -> dict[tuple[str, str], float]:
    """Return the lowest trip temperature of each zone and kind."""
    found: dict[tuple[str, str], float] = {}
    for trip in thermal.glob("thermal_zone*/trip_point_*_type"):
        kind = text_of(trip).strip()
        celsius = _read_celsius(trip.with_name(trip.name.replace("_type", "_temp")))
        if kind in _TRIP_KINDS and celsius is not None and celsius > 0.0:
            key = _read_name(trip.with_name("type")), kind
            found[key] = min(celsius, found.get(key, celsius))
    return found


def _throttling(thermal: Path) -> Iterator[tuple[str, float]]:
    for device in thermal.glob("cooling_device*"):
        state, most = _read_number(device / "cur_state"), _read_number(device / "max_state")
        name = _read_name(device / "type")
        if state is not None and most and "fan" not in name.lower():
            # Some devices read -1 while they limit nothing.
            yield name, min(max(state / most, 0.0), 1.0)


def _over_current(hwmon: Path) -> Iterator[tuple[str, int]]:
    for chip in _chips(hwmon, _OVER_CURRENT):
        for file in chip.glob("oc*_event_cnt"):
            events = _read_number(file)
            if events is not None:
                yield file.name.partition("_")[0], events


def _power(hwmon: Path) -> Iterator[tuple[str, float]]:
    """Yield the power of a Jetson's rails, and of the entire input on a Thor (INA238)."""
    for chip in _chips(hwmon, "ina3221"):
        for label in chip.glob("in*_label"):
            rail, number = _read_name(label), label.name[2 : -len("_label")]  # 1 of `in1_label`
            milli = (  # millivolts, milliamperes
                _read_number(chip / f"in{number}_input"),
                _read_number(chip / f"curr{number}_input"),
            )
            if None not in milli and "shunt" not in rail:
                yield rail, milli[0] * milli[1] * 1e-6
    for chip in _chips(hwmon, "ina238"):
        if (micro_w := _read_number(chip / "power1_input")) is not None:
            yield "VIN", micro_w * 1e-6


def _memory(meminfo: str) -> Iterator[tuple[str, int]]:
    for key, name in (("total", "MemTotal"), ("available", "MemAvailable")):
        if match := re.search(rf"^{name}:\s*(\d+) kB", meminfo, re.MULTILINE):
            yield key, int(match[1]) * 1024


def _chips(hwmon: Path, name: str) -> list[Path]:
    return [chip for chip in hwmon.glob("hwmon*") if text_of(chip / "name").strip() == name]


def _highest(found: Iterator[tuple[str, float]]) -> dict[str, float]:
    """Return the highest value of each name, since all cores of a processor share a name."""
    highest: dict[str, float] = {}
    for name, value in found:
        highest[name] = max(value, highest.get(name, value))
    return highest


def _read_celsius(file: Path) -> float | None:
    milli = _read_number(file)
    if milli is None or not _COLDEST_C < milli * 1e-3 < _HOTTEST_C:
        return None
    return milli * 1e-3


def _read_number(file: Path) -> int | None:
    """Return the integer in a file, of at most 18 digits; None for other content."""
    match = re.fullmatch(r"-?[0-9]{1,18}", text_of(file).strip())
    return int(match[0]) if match else None


def _read_name(file: Path) -> str:
    return one_line(text_of(file), _MAX_NAME_CHARS) or "unknown"
