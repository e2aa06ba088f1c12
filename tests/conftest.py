"""Fixtures that every test may use."""

from __future__ import annotations

import faulthandler
import fcntl
import logging
import os
import subprocess
import sys
from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TextIO

import pytest
from hypothesis import HealthCheck, settings

# No example may fail because the machine is slow, and CI must not fail today on an example that it
# did not draw yesterday.
settings.register_profile(
    "edge",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    max_examples=60 if os.environ.get("CI") else 15,
    derandomize=bool(os.environ.get("CI")),
)
settings.load_profile("edge")

# The tests start some hundred interpreters. Without bytecode each would compile `edge` again, and
# each worker would rewrite the asserts of all tests again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

HERE = Path(__file__).resolve().parent
SHARED = HERE.parents[1] / "shared"

# Longer than a test of live processes waits for any event, so that it can say what did not
# happen.
LIVE = ("integration", "attacks")
LIVE_LIMIT_S = 900
# Folders with tests that wait for a service or a part of it, in a process or on a thread.
SERVICES = {
    *LIVE, "drives", "lab", "live", "loop", "perception", "recording", "ros2_adapter", "sinks",
    "sources",
}  # fmt: skip

# pytest-timeout ends a test by an exception in its main thread: it does nothing for a kernel or a
# library that never returns to Python, nor once more for a fixture that then hangs as well. After
# this much longer the entire process ends, with a look at its threads; xdist starts another.
HARD_EXTRA_S = 60


MOST_WORKERS = 8


def pytest_xdist_auto_num_workers() -> int:
    """One more than there are cores: while a test waits for its processes, others go on."""
    return min(len(os.sched_getaffinity(0)) + 1, MOST_WORKERS)


# Kernels that this checkout has not compiled yet: each worker would compile all of them, for a
# minute and a half. It is done once, while they collect; numba compiles on one core at a time, so a
# second process does those of perception before the first has come to them, and then those of tasks
# and value maps, which the first does not need.
EPISODE = """
import tempfile
from pathlib import Path
import numpy as np
from small_house import small_house
from edge.lab.eval.arms import make_arms
from edge.lab.eval.drive import run_episode
from edge.lab.eval.episodes import make_episode, sensing_settings
from edge.lab.eval.trajectory_metrics import frechet_m, ndtw
with tempfile.TemporaryDirectory() as folder:
    config = small_house(Path(folder), sensors={"lidar": {}})
    world = config.sim.world.model_dump()
    episode = make_episode(world, "small", (1.0, 2.0, 0.0), 5.0, sensing_settings(config), "bed")
    outcome = run_episode(make_arms(config, {"own": {}})[0], episode, Path(folder))
    assert outcome.success, outcome
a_m = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 3.0]])
frechet_m(a_m, a_m[::2] + 0.1), ndtw(a_m, a_m[::2] + 0.1)
"""
PERCEPTION = """
from edge.config import MappingConfig
from edge.loop.warmup import warm_perception, warm_tasks, warm_values
warm_perception()
warm_values(MappingConfig())
warm_tasks()
"""
_compiling: list[subprocess.Popen] = []
# In a new checkout the asserts of all tests have to be rewritten as well, which takes twice as long
# as all else of collecting. The first worker does it; the others wait for this, and find it done.
_rewriting: list[TextIO] = []


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    all_are_run = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    folders = {Path(argument).name for argument in config.args if os.path.isdir(argument)}
    if (all_are_run or (len(folders) > 1 and folders & SERVICES)) and _start_compiling():
        _rewriting.append(open(__file__))  # noqa: SIM115
        fcntl.flock(_rewriting[0], fcntl.LOCK_EX)


def _start_compiling() -> bool:
    """Compile the kernels in the background if this checkout has none, or older ones."""
    if _compiling or _has_kernels():
        return False
    for code in (EPISODE, PERCEPTION):
        _compiling.append(subprocess.Popen([sys.executable, "-c", code], cwd=HERE))
    return True


def _has_kernels() -> bool:
    """Return True if the kernels are compiled; delete those whose module has changed since."""
    compiled = f"*.py{sys.version_info.major}{sys.version_info.minor}.nbi"
    indexes = list((HERE.parent / "edge").rglob(compiled))
    old = [index for index in indexes if _is_older(index)]
    for index in old:
        index.unlink(missing_ok=True)
    return bool(indexes) and not old


def _is_older(index: Path) -> bool:
    """Return True if numba's index of a kernel is older than the kernel's module."""
    module = index.parents[1] / f"{index.name.partition('.')[0]}.py"
    return not module.exists() or module.stat().st_mtime > index.stat().st_mtime


def _compile_for(tests: Iterable[str]) -> None:
    """Wait until the kernels are compiled, if one of the tests waits for a service.

    Otherwise the service compiles them while the test loses its patience.
    """
    folders = {test.partition("/")[0] for test in tests}
    if folders & SERVICES:
        _start_compiling()
    for process in _compiling:
        process.wait()


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    worker = getattr(session.config, "workerinput", {}).get("workerid", "gw0")
    if worker != "gw0":
        with open(__file__) as file:
            fcntl.flock(file, fcntl.LOCK_SH)
    return (yield)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(ids: Sequence[str]) -> None:
    _let_others_collect()
    _compile_for(id.removeprefix("tests/") for id in ids)


def pytest_collection_finish(session: pytest.Session) -> None:
    # For a worker, its controller does it.
    if not (hasattr(session.config, "workerinput") or session.config.option.collectonly):
        inside = [item.path for item in session.items if HERE in item.path.parents]
        _compile_for(str(path.relative_to(HERE)) for path in inside)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown() -> None:
    _let_others_collect()


def _let_others_collect() -> None:
    for file in _rewriting:
        file.close()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    folders = {HERE / name for name in LIVE}
    for item in items:
        if folders & set(item.path.parents) and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(LIVE_LIMIT_S))
    # First the longest: at the end, the other workers would wait for them.
    items.sort(key=lambda item: _limit_s(item) <= LIVE_LIMIT_S)


def _limit_s(item: pytest.Item) -> float:
    marker = item.get_closest_marker("timeout")
    return marker.args[0] if marker is not None else float(item.config.getini("timeout"))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    _end_after(_limit_s(item) + HARD_EXTRA_S)
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()


@pytest.hookimpl(trylast=True)
def pytest_exception_interact(node: pytest.Item | pytest.Collector) -> None:
    """Before, pytest has called off what was to end the process; a tear-down is still to come."""
    if isinstance(node, pytest.Item):
        _end_after(HARD_EXTRA_S)


def _end_after(seconds: float) -> None:
    faulthandler.dump_traceback_later(seconds, exit=True, file=sys.__stderr__)


@pytest.fixture(autouse=True)
def _logging_as_before() -> Iterator[None]:
    """Commands that run in this process set up logging; the next test must not inherit it."""
    root, edge = logging.getLogger(), logging.getLogger("edge")
    before = (root.level, list(root.handlers), edge.level)
    yield
    root.handlers[:] = before[1]
    root.setLevel(before[0])
    edge.setLevel(before[2])


@pytest.fixture(autouse=True)
def _no_overrides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clear the developer's own environment overrides."""
    for name in [name for name in os.environ if name.startswith("EDGE__")]:
        monkeypatch.delenv(name)


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """Return the shared folder of papers, worlds, logs and weights; skip if it is missing."""
    if not SHARED.is_dir():
        pytest.skip(f"test data not there: {SHARED.name}/ beside the clone")
    return SHARED


@pytest.fixture
def cards(tmp_path, monkeypatch):
    """Return an empty folder of cards next to an empty model cache."""
    from edge.host import resources

    folder = tmp_path / "cards"
    folder.mkdir()
    monkeypatch.setattr(resources, "data_dir", lambda kind: folder)
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("EDGE_VOCABULARY", raising=False)
    resources.models_dir().mkdir(parents=True)
    return folder
