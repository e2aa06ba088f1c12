"""Facts about a machine, from made-up files for each kind."""

from __future__ import annotations

import pytest

from edge.host import machine

ORIN = {
    "proc/cpuinfo": "processor\t: 0\nCPU part\t: 0xd42\n\nprocessor\t: 1\nCPU part\t: 0xd42\n",
    "proc/meminfo": "MemTotal:       15655436 kB\nMemFree: 1 kB\n",
    "proc/device-tree/model": "NVIDIA Jetson Orin NX Engineering Reference Developer Kit\0",
    "etc/nv_tegra_release": "# R36 (release), REVISION: 4.3, GCID: 38968081, BOARD: generic",
    "etc/nvpmodel.conf": "< POWER_MODEL ID=0 NAME=MAXN >\n< POWER_MODEL ID=3 NAME=25W >\n",
    "var/lib/nvpmodel/status": "pmode:0003",
}


def put(root, files):
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


@pytest.fixture(autouse=True)
def no_smi(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))


def test_an_unreadable_system_still_gets_a_description(tmp_path):
    found = machine.describe(tmp_path)
    assert found["cpu"] == found["architecture"]
    assert not {"memory_gb", "gpus", "jetson"} & set(found)
    assert f"{found['cores']} cores" in machine.summary(found)
    assert machine.busy_s(tmp_path) is None


def test_a_jetson_reports_its_board_and_power_mode(tmp_path):
    put(tmp_path, ORIN)
    found = machine.describe(tmp_path)
    assert found["cpu"] == "Cortex-A78AE"
    assert found["memory_gb"] == 16.0
    assert found["jetson"] == {
        "release": "R36 (release), REVISION: 4.3",
        "model": "NVIDIA Jetson Orin NX Engineering Reference Developer Kit",
        "power_mode": "25W",
    }
    assert machine.short_name(found).endswith("Developer Kit, 25W")
    assert "power mode 25W" in machine.summary(found)


@pytest.mark.parametrize(
    ("status", "conf", "mode"),
    [
        ("", "", None),
        ("garbage", "< POWER_MODEL ID=0 NAME=MAXN >", None),
        ("pmode:0000", "< POWER_MODEL ID=0 NAME=MAXN >", "MAXN"),
        ("pmode:0002\n", "< POWER_MODEL ID=02 NAME=MODE_15W >", "MODE_15W"),
        ("pmode:0001", "< POWER_MODEL ID=10 NAME=X >", "1"),
    ],
)
def test_power_mode(status, conf, mode):
    assert machine.power_mode(status, conf) == mode


@pytest.mark.parametrize(
    ("script", "names", "memory_mb"),
    [
        ("exit 9", [], None),
        ("echo 'NVIDIA H100, 1, 2, 3'", ["NVIDIA H100"], None),
        ("echo 1024; echo 6", [], 1030.0),
        ("echo '[N/A]'", [], None),
    ],
)
def test_nvidia_smi_output_is_read_or_ignored(tmp_path, script, names, memory_mb):
    put(tmp_path, {"bin/nvidia-smi": f"#!/bin/sh\n{script}\n"})
    (tmp_path / "bin/nvidia-smi").chmod(0o755)
    assert [gpu["name"] for gpu in machine.nvidia_smi()] == names
    assert machine.gpu_memory_mb() == memory_mb


def test_busy_time_counts_steal_time_but_not_waiting(tmp_path, monkeypatch):
    put(tmp_path, {"proc/stat": "cpu  100 10 50 9999 888 5 5 30 7 0\ncpu0 1 2\n"})
    monkeypatch.setattr(machine.os, "sysconf", lambda _: 100)
    assert machine.busy_s(tmp_path) == pytest.approx(2.0)
