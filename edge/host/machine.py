"""A description of this machine: all that a measured time depends on, as plain data.

The values come from files of Linux and from `nvidia-smi`. Values that cannot be read are left out.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

Description = dict[str, Any]
"""Our name of a value → value; see `describe`."""

_ROOT = Path("/")
_RUNTIMES = {
    "onnxruntime": ("onnxruntime-gpu", "onnxruntime"),
    "tensorrt": ("tensorrt", "tensorrt-cu12", "tensorrt-cu13"),
}
"""Package → distributions that install it."""

# Part numbers of Arm, since its kernels report no name (linux: asm/cputype.h).
_ARM_PARTS = {
    "0xd03": "Cortex-A53",
    "0xd07": "Cortex-A57",
    "0xd08": "Cortex-A72",
    "0xd0b": "Cortex-A76",
    "0xd0c": "Neoverse-N1",
    "0xd40": "Neoverse-V1",
    "0xd42": "Cortex-A78AE",
    "0xd83": "Neoverse-V3AE",
}
# Our name → field of `nvidia-smi`.
_SMI_FIELDS = {
    "name": "name",
    "driver": "driver_version",
    "power_limit_w": "power.limit",
    "memory_mb": "memory.total",
}
_SMI_S = 20.0  # timeout of nvidia-smi


def describe(root: Path = _ROOT) -> Description:
    """Return processor, memory, system, runtimes, GPUs and a Jetson's power mode.

    Args:
        root: folder with `proc`, `sys`, `etc` and `var`.
    """
    found: Description = {
        "cpu": this_cpu(root),
        "architecture": platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "memory_gb": _memory_gb(root),
        "kernel": platform.release(),
        "python": platform.python_version(),
        **{name: _version(names) for name, names in _RUNTIMES.items()},
        "gpus": nvidia_smi(),
        "jetson": _jetson(root),
    }
    return {key: value for key, value in found.items() if value}


def summary(machine: Description) -> str:
    """Return one line for people: processor, cores, memory, GPU, power mode, runtimes."""
    parts = [f"{machine['cpu']}, {machine['cores']} cores"]
    if memory := machine.get("memory_gb"):
        parts.append(f"{memory:.0f} GB")
    parts += [gpu["name"] for gpu in machine.get("gpus", ())]
    jetson = machine.get("jetson", {})
    if model := jetson.get("model"):
        parts.append(model)
    if mode := jetson.get("power_mode"):
        parts.append(f"power mode {mode}")
    parts += [f"{name} {machine[name]}" for name in ("python", *_RUNTIMES) if name in machine]
    return "; ".join(parts)


def short_name(machine: Description) -> str:
    """Return a short name: the board, or the processor and its cores, and the power mode.

    Args:
        machine: as `describe` returns it.

    >>> short_name({"cpu": "AMD EPYC", "cores": 8})
    'AMD EPYC, 8 cores'
    """
    jetson = machine.get("jetson", {})
    name = jetson.get("model") or f"{machine['cpu']}, {machine['cores']} cores"
    return f"{name}, {jetson['power_mode']}" if "power_mode" in jetson else name


def identity() -> str:
    """Return the `short_name` of the computer, with all its cores, as key of a measured speed."""
    return short_name({"cpu": this_cpu(), "cores": os.cpu_count(), "jetson": _jetson(_ROOT)})


def boot_id() -> str:
    """Return the kernel's id of this boot; "" if it has none."""
    return text_of(_ROOT / "proc/sys/kernel/random/boot_id").strip()[:64]


def this_cpu(root: Path = _ROOT) -> str:
    """Return the name of this machine's processor, or its architecture."""
    return cpu_name(text_of(root / "proc/cpuinfo")) or platform.machine()


def cpu_name(cpuinfo: str) -> str | None:
    """Return the processor's name from the text of /proc/cpuinfo.

    >>> cpu_name("processor: 0\\nmodel name\\t: AMD EPYC\\n"), cpu_name("CPU part\\t: 0xd42\\n")
    ('AMD EPYC', 'Cortex-A78AE')
    """
    if match := re.search(r"^model name\s*:\s*(.+)$", cpuinfo, re.MULTILINE):
        return " ".join(match[1].split())
    parts = dict.fromkeys(re.findall(r"^CPU part\s*:\s*(\w+)$", cpuinfo, re.MULTILINE))
    return " + ".join(_ARM_PARTS.get(part, part) for part in parts) or None


def tegra_release(path: Path) -> str | None:
    """Return release and revision from /etc/nv_tegra_release; None if this is no Jetson.

    The file begins like `# R36 (release), REVISION: 4.3, GCID: …`.
    """
    parts = text_of(path).split(",")[:2]
    return ", ".join(part.strip("# \n") for part in parts) or None


def power_mode(status: str, conf: str) -> str | None:
    """Return the name of the power mode from nvpmodel's two files, or its number.

    >>> power_mode("pmode:0002", "< POWER_MODEL ID=0 NAME=MAXN >\\n< POWER_MODEL ID=2 NAME=15W >")
    '15W'
    """
    if not (match := re.search(r"pmode:\s*(\d+)", status)):
        return None
    number = int(match[1])
    name = re.search(rf"<\s*POWER_MODEL\s+ID=0*{number}\s+NAME=(\S+)", conf)
    return name[1] if name else str(number)


def power_mode_of(root: Path = _ROOT) -> str | None:
    """Return the Jetson's present power mode; None if this is no Jetson."""
    conf = text_of(root / "etc/nvpmodel.conf")
    return power_mode(text_of(root / "var/lib/nvpmodel/status"), conf)


def nvidia_smi(fields: dict[str, str] = _SMI_FIELDS) -> list[dict[str, str]]:
    """Return the fields of each GPU from `nvidia-smi`, by our names; [] if it does not run."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return []
    query = [program, f"--query-gpu={','.join(fields.values())}", "--format=csv,noheader,nounits"]
    try:
        answer = subprocess.run(query, capture_output=True, text=True, timeout=_SMI_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return []
    rows = (line.split(", ") for line in answer.stdout.splitlines() if line.strip())
    return [dict(zip(fields, row, strict=True)) for row in rows if len(row) == len(fields)]


def busy_s(root: Path = _ROOT) -> float | None:
    """Return the CPU time of all processes since the boot; None if it is unknown.

    It includes time that the host has taken from this virtual machine.
    """
    match = re.match(r"cpu +(.+)", text_of(root / "proc/stat"))
    if match is None:
        return None
    # Without `idle` and `iowait`. The field after `softirq` is `steal`: time that the host took.
    user, nice, system, _, _, irq, softirq, *more = map(int, match[1].split())
    return (user + nice + system + irq + softirq + sum(more[:1])) / os.sysconf("SC_CLK_TCK")


def gpu_memory_mb() -> float | None:
    """Return the used memory of all GPUs together; None if it is unknown."""
    used = [row["used"] for row in nvidia_smi({"used": "memory.used"})]
    try:
        return sum(map(float, used)) if used else None
    except ValueError:  # "[N/A]" on a Jetson, whose GPU uses the processor's memory
        return None


def _jetson(root: Path) -> Description:
    """Describe a Jetson; {} on any other computer."""
    release = tegra_release(root / "etc/nv_tegra_release")
    if release is None:
        return {}
    found = {
        "release": release,
        "model": text_of(root / "proc/device-tree/model").strip("\0 \n"),
        "power_mode": power_mode_of(root),
    }
    return {key: value for key, value in found.items() if value}


def _memory_gb(root: Path) -> float | None:
    match = re.search(r"^MemTotal:\s*(\d+) kB", text_of(root / "proc/meminfo"), re.MULTILINE)
    return round(int(match[1]) * 1024 / 1e9, 1) if match else None


def _version(distributions: tuple[str, ...]) -> str | None:
    for name in distributions:
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return None


def text_of(path: Path) -> str:
    """Return the text of a file; "" if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
