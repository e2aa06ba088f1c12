"""Facts about a board, from made-up file trees for each kind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from edge.host.board import BoardReading, read_board, throttling_reason

NOTHING = BoardReading({}, {}, {}, {}, {}, {}, None)
THERMAL, HWMON = "sys/class/thermal", "sys/class/hwmon"


def zone(number: int, kind: str, temp: str, **trips: str) -> dict[str, str]:
    """Write a thermal zone with trip points by name, such as `passive="99000"`."""
    folder = f"{THERMAL}/thermal_zone{number}"
    found = {f"{folder}/type": f"{kind}\n", f"{folder}/temp": f"{temp}\n"}
    for i, (trip, milli_c) in enumerate(trips.items()):
        found[f"{folder}/trip_point_{i}_type"] = f"{trip.rstrip('_')}\n"
        found[f"{folder}/trip_point_{i}_temp"] = f"{milli_c}\n"
    return found


def cooling(number: int, kind: str, state: str, most: str) -> dict[str, str]:
    folder = f"{THERMAL}/cooling_device{number}"
    names = ("type", "cur_state", "max_state")
    return {f"{folder}/{n}": f"{v}\n" for n, v in zip(names, (kind, state, most), strict=True)}


MEMORY = {"proc/meminfo": "MemTotal:  1000 kB\nMemFree: 1 kB\nMemAvailable:  400 kB\n"}
# An Orin with JetPack 6: one rail of three, cv0 is switched off, and something is throttled.
ORIN = {
    **zone(0, "cpu-thermal", "51687", active="60000", passive="99000", passive_="95500",
           hot="104500", critical="105000"),
    **zone(1, "cv0-thermal", "-256000"),
    **zone(8, "tj-thermal", "52000"),
    **cooling(0, "pwm-fan", "3", "4"),
    **cooling(1, "cpu-throttle-alert", "0", "2"),
    **cooling(2, "gpu-throttle-alert", "1", "2"),
    f"{HWMON}/hwmon1/name": "ina3221\n",
    f"{HWMON}/hwmon1/in1_label": "VDD_IN\n",
    f"{HWMON}/hwmon1/in1_input": "5000\n",
    f"{HWMON}/hwmon1/curr1_input": "1600\n",
    f"{HWMON}/hwmon1/in7_label": "sum of shunt voltages\n",
    f"{HWMON}/hwmon1/in7_input": "900\n",
    f"{HWMON}/hwmon1/curr7_input": "900\n",
    f"{HWMON}/hwmon3/name": "soctherm_oc\n",
    f"{HWMON}/hwmon3/oc1_event_cnt": "0\n",
    f"{HWMON}/hwmon3/oc3_event_cnt": "27\n",
    "etc/nvpmodel.conf": "< POWER_MODEL ID=0 NAME=MAXN >\n< POWER_MODEL ID=3 NAME=25W >\n",
    "var/lib/nvpmodel/status": "pmode:0003",
    **MEMORY,
}  # fmt: skip
# A Thor with JetPack 7.
THOR = {
    **zone(0, "cpu-thermal", "41000"),
    **cooling(0, "soc345-throttle-alert", "0", "2"),
    **cooling(1, "devfreq-gpu-gpc-0", "0", "169"),
    f"{HWMON}/hwmon2/name": "ina238\n",
    f"{HWMON}/hwmon2/power1_input": "22500000\n",
}
# A laptop: two zones and all cores are called alike, one device says -1 when it is off.
LAPTOP = {
    **zone(0, "acpitz", "40000", critical="0"),
    **zone(1, "acpitz", "47000"),
    **cooling(0, "Processor", "0", "10"),
    **cooling(1, "Processor", "5", "10"),
    **cooling(2, "intel_powerclamp", "-1", "100"),
    **cooling(3, "Fan", "1", "1"),
}


def put(root: Path, files: dict[str, str | bytes]) -> Path:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return root


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, NOTHING),
        (MEMORY, BoardReading({}, {}, {}, {}, {}, {"total": 1024000, "available": 409600}, None)),
        (
            ORIN,
            BoardReading(
                {"cpu-thermal": 51.687, "tj-thermal": 52.0},
                {("cpu-thermal", "passive"): 95.5, ("cpu-thermal", "hot"): 104.5,
                 ("cpu-thermal", "critical"): 105.0},
                {"cpu-throttle-alert": 0.0, "gpu-throttle-alert": 0.5},
                {"oc1": 0, "oc3": 27},
                {"VDD_IN": pytest.approx(8.0)},
                {"total": 1024000, "available": 409600},
                "25W",
            ),
        ),
        (
            THOR,
            BoardReading(
                {"cpu-thermal": 41.0}, {}, {"soc345-throttle-alert": 0.0, "devfreq-gpu-gpc-0": 0.0},
                {}, {"VIN": 22.5}, {}, None,
            ),
        ),
        (LAPTOP, BoardReading({"acpitz": 47.0}, {}, {"Processor": 0.5, "intel_powerclamp": 0.0},
                       {}, {}, {}, None)),
    ],
    ids=["nothing", "memory only", "Orin", "Thor", "laptop"],
)  # fmt: skip
def test_every_kind_of_board(tmp_path, files, expected):
    assert read_board(put(tmp_path, files)) == expected


GARBAGE = [
    b"", b"\0", b"n/a", b"\xff\xfe", b"1e9", b"9" * 400, "５".encode(), b"-", b"0x10", b"1\n2",
]  # fmt: skip


@pytest.mark.parametrize("garbage", GARBAGE)
@pytest.mark.parametrize(
    ("file", "lost"),
    [
        (f"{THERMAL}/thermal_zone0/temp", "temperature_c"),
        (f"{THERMAL}/cooling_device2/cur_state", "throttled"),
        (f"{HWMON}/hwmon3/oc3_event_cnt", "over_current"),
        (f"{HWMON}/hwmon1/curr1_input", "power_w"),
    ],
)
def test_an_unreadable_sensor_loses_only_its_own_value(tmp_path, file, garbage, lost):
    whole = read_board(put(tmp_path / "whole", ORIN))
    damaged = read_board(put(tmp_path / "damaged", {**ORIN, file: garbage}))
    for name in BoardReading.__slots__:
        before, after = getattr(whole, name), getattr(damaged, name)
        if name == lost:
            assert len(after) == len(before) - 1
        else:
            assert after == before


@pytest.mark.parametrize("gone", sorted(ORIN))
def test_a_missing_file_raises_nothing(tmp_path, gone):
    root = put(tmp_path, ORIN)
    (root / gone).unlink()
    assert isinstance(read_board(root), BoardReading)
    (root / gone).mkdir()
    assert isinstance(read_board(root), BoardReading)


WARM = replace(
    NOTHING, temperature_c={"gpu": 40.0, "tj": 94.0},
    trip_c={("tj", "passive"): 99.0, ("tj", "hot"): 104.5, ("dead", "passive"): 1.0},
)  # fmt: skip


@pytest.mark.parametrize(
    ("board", "before", "margin_c", "why"),
    [
        (NOTHING, None, 3.0, ""),
        (WARM, None, 0.0, ""),
        (WARM, WARM, 3.0, ""),
        (WARM, None, 5.0, "tj is at 94 C, passive from 99 C"),
        (replace(NOTHING, throttled={"cpu": 0.0, "gpu": 0.25}), None, 0.0,
         "gpu is throttled by 25%"),
        (replace(NOTHING, over_current={"oc1": 7}), None, 0.0, ""),
        (replace(NOTHING, over_current={"oc1": 7}), NOTHING, 0.0, ""),
        (replace(NOTHING, over_current={"oc1": 7}), replace(NOTHING, over_current={"oc1": 7}),
         0.0, ""),
        (replace(NOTHING, over_current={"oc1": 7}), replace(NOTHING, over_current={"oc1": 6}),
         0.0, "the board throttles, it draws too much current (oc1)"),
    ],
)  # fmt: skip
def test_throttling_reason_reports_heat_and_overcurrent(board, before, margin_c, why):
    assert throttling_reason(board, before, margin_c) == why
