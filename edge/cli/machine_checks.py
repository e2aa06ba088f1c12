"""Checks of `edge doctor` for the machine itself.

Each check is a function that takes the configuration and yields findings.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator
from importlib import import_module, metadata
from pathlib import Path

from edge.cli.findings import Finding, fail, ok, ok_or_warn, warn
from edge.cli.onnx_probe import CUDA, fault_of
from edge.config import Config
from edge.host import calibration, machine, resources
from edge.host.files import make_writable
from edge.host.stop_latch import read_stop, stop_file
from edge.perception.runtime.sessions import TENSORRT

PYTHON_FROM, PYTHON_BELOW = (3, 10), (3, 14)
"""Versions of Python that are supported: from the first, below the second."""
MIN_CORES = 2
MIN_SHM_MB = 64
"""Least size of the shared memory."""
MIN_FREE_MB = 500
"""Least free space in the cache folder."""
CORE_MODULES = ("numpy", "cv2", "mcap")
"""Modules whose import is tested."""
OPENCV = (
    "opencv-python-headless", "opencv-python", "opencv-contrib-python",
    "opencv-contrib-python-headless",
)  # fmt: skip
"""Packages that contain the folder `cv2`."""
TEGRA_RELEASE = Path("/etc/nv_tegra_release")
SHM = Path("/dev/shm")
_MB = 1 << 20


def check_python(config: Config) -> Iterator[Finding]:
    version = sys.version_info[:2]
    what = f"Python {platform.python_version()} on {platform.machine()}"
    low, high = (".".join(map(str, v)) for v in (PYTHON_FROM, PYTHON_BELOW))
    if PYTHON_FROM <= version < PYTHON_BELOW:
        yield ok(what)
    else:
        yield fail(f"{what} is not supported", f"install Python >= {low}, < {high}")


def check_cores(config: Config) -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0))
    todo = f"use at least {MIN_CORES} cores: with 1, a detector on the CPU delays the ticks"
    yield ok_or_warn(cores >= MIN_CORES, f"{cores} CPU core{'s' * (cores > 1)}", todo)


def check_speed(config: Config) -> Iterator[Finding]:
    stored = calibration.load()
    if stored is not None:
        yield ok(f"speed of {stored.machine}: {stored}")
    else:
        todo = f"{calibration.HINT}; until then reports compare with deadlines, not with budgets"
        yield warn("the speed of this computer is not measured yet", todo)


def check_packages(config: Config) -> Iterator[Finding]:
    """Check that core packages can be imported (libGL may be missing, NumPy wrong, …)."""
    versions = []
    for module in CORE_MODULES:
        try:
            versions.append(f"{module} {import_module(module).__version__}")
        except ImportError as error:
            todo = "reinstall edge-vln and all its dependencies"
            yield fail(f"{module} cannot be imported: {error}", todo)
    if versions:
        yield ok(", ".join(versions))


def check_opencv(config: Config) -> Iterator[Finding]:
    """Check that only one OpenCV package is installed: all of them share the folder `cv2`."""
    found = [name for name in OPENCV if is_installed(name)]
    if len(found) > 1:
        todo = f"pip uninstall {' '.join(found)}, then pip install {OPENCV[0]}"
        yield warn(f"{' and '.join(found)} overwrite each other's files", todo)


def is_installed(package: str) -> bool:
    """Return True if a package is installed."""
    try:
        metadata.distribution(package)
    except metadata.PackageNotFoundError:
        return False
    return True


def check_jetson(config: Config) -> Iterator[Finding]:
    """Check that onnxruntime or TensorRT can use the GPU of a Jetson."""
    name = machine.tegra_release(TEGRA_RELEASE)
    if name is None:
        return
    detector = config.perception.detector
    with_tensorrt = detector.kind == "onnx" and TENSORRT in detector.providers
    if with_tensorrt or not fault_of(CUDA):
        yield ok(f"Jetson: {name}")
    else:
        todo = (
            "set perception.detector.providers to [tensorrt], or install NVIDIA's onnxruntime-gpu "
            "for this JetPack (docs/install.md)"
        )
        yield warn(f"Jetson: {name}: onnxruntime cannot use the GPU", todo)


def check_shared_memory(config: Config) -> Iterator[Finding]:
    """Check that Zenoh's shared memory is large enough."""
    if not config.zenoh.shared_memory:
        return
    what = f"shared memory: {SHM}"
    if not SHM.is_dir():
        yield warn(f"{what} does not exist", f"mount {SHM}; until then images go over TCP")
        return
    size_mb = shutil.disk_usage(SHM).total // _MB
    todo = f"give it {MIN_SHM_MB} MB or more for images (docker run --shm-size=256m or --ipc=host)"
    yield ok_or_warn(size_mb >= MIN_SHM_MB, f"{what} has {size_mb} MB", todo)


def check_stop(config: Config) -> Iterator[Finding]:
    """Check if the robot is stopped, and if a stop can be kept."""
    path = stop_file(config.zenoh.prefix)
    if path is None:
        todo = "set XDG_STATE_HOME to a folder that it can write, else a restart forgets a stop"
        yield warn(f"stop: user {os.getuid()} has no home folder", todo)
    elif reason := read_stop(path):
        todo = "release it with `edge release`; without a service, remove the file"
        yield warn(f"stop: the robot is stopped ({path}): {reason}", todo)
    elif not os.access(next(p for p in path.parents if p.exists()), os.W_OK):
        todo = "let the service's user write there, else a restart forgets a stop"
        yield warn(f"stop: {path.parent} cannot be written", todo)


def check_cache(config: Config) -> Iterator[Finding]:
    """Check that the cache folder can be written and has free space."""
    path = resources.cache_dir()
    try:
        make_writable(path)
    except OSError as error:
        todo, reason = "set EDGE_CACHE_DIR to another folder", error.strerror or error
        yield warn(f"cache folder {path} cannot be written: {reason}", todo)
        return
    free_mb = shutil.disk_usage(path).free // _MB
    todo = f"free some space: models and recordings need {MIN_FREE_MB} MB"
    yield ok_or_warn(free_mb >= MIN_FREE_MB, f"cache folder {path}: {free_mb} MB free", todo)


def _add(a: int, b: int) -> int:
    """Add two numbers; `check_numba` compiles it."""
    return a + b


def check_numba(config: Config) -> Iterator[Finding]:
    """Check that numba compiles, and can store what it compiles."""
    import numba

    before = time.perf_counter()
    what = f"numba {numba.__version__}"
    if numba.njit(nogil=True)(_add)(2, 3) != 5:
        yield fail(f"{what}: a compiled function returns a wrong result", "reinstall numba")
        return
    took_s = time.perf_counter() - before
    yield ok(f"{what} works: compiled a test function in {took_s:.1f} s")
    try:
        path = Path(numba.njit(cache=True)(_add).stats.cache_path)
    except RuntimeError:
        todo = "set NUMBA_CACHE_DIR to a writable folder, else every start compiles all kernels"
        yield warn("numba finds no writable folder for compiled kernels", todo)
    else:
        yield ok(f"numba stores compiled kernels in {path}")
