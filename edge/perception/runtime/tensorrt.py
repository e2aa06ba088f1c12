"""TensorRT engines: built from ONNX, cached, and run without onnxruntime.

Written for TensorRT 10 (JetPack 6 and 7) and 11, whose networks are always strongly typed: the
file's own types decide what is float32, float16 or int8. So no builder flag sets a precision: it
would override the types that were measured. TensorRT's Python package comes with JetPack, or from
the package index on x86-64 (extra `tensorrt`). TensorRT calls a serialized engine a plan.
https://docs.nvidia.com/deeplearning/tensorrt/latest/_static/python-api/
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edge.perception.runtime.binding import BoundSession, Shapes
from edge.perception.runtime.cuda import Device
from edge.perception.runtime.engines import EngineOptions, cached_engine
from edge.perception.runtime.model_file import ModelError
from edge.text import one_line

log = logging.getLogger(__name__)

_PLAN = "model.engine"  # file name of the engine
_WORKSPACE_BYTES = 1 << 30  # GPU memory that the builder may use
_PARENT, _DONE = 0, 2  # indices in a phase; see `progress_text`
RECIPE = 1
"""Version of the builder settings in `build_plan`; increase it when they change."""


def load() -> Any:
    """Import `tensorrt`; raise ModelError if it is not installed."""
    try:
        import tensorrt
    except ImportError:
        raise ModelError(
            "TensorRT for Python is not installed: pip install edge-vln[tensorrt]; on a Jetson "
            "use JetPack's TensorRT, in a venv made with --system-site-packages"
        ) from None
    return tensorrt


def open_engine(path: Path, device_id: int, options: EngineOptions) -> TensorrtSession:
    """Open the engine of an ONNX file, from the cache or built now.

    Raises:
        ModelError: TensorRT, the GPU or the cache cannot be used, or TensorRT refuses the model.
    """
    trt, device = load(), Device(device_id)

    def build(folder: Path, note: Callable[[str], None]) -> None:
        plan = build_plan(trt, path, options.shapes, note)
        (folder / _PLAN).write_bytes(plan)

    folder = cached_engine(
        path,
        options,
        build,
        device_id,
        builder="tensorrt",
        tensorrt=str(trt.__version__),
        recipe=RECIPE,
    )
    logger = make_logger(trt)
    runtime = trt.Runtime(logger)
    engine = runtime.deserialize_cuda_engine((folder / _PLAN).read_bytes())
    if engine is None:  # the cache has checked file, GPU and version, so memory is short
        raise ModelError(
            f"{folder}: TensorRT cannot load this engine: {logger.last}; free memory on the GPU, "
            "or remove the folder to have the engine built again"
        )
    return TensorrtSession((logger, runtime), engine, device)


def build_plan(trt: Any, path: Path, shapes: Mapping[str, Any], note: Callable[[str], None]) -> Any:
    """Build the engine of an ONNX file, which takes minutes.

    Returns:
        The serialized engine, a buffer.

    Raises:
        ModelError: TensorRT refuses the model.
    """
    logger = make_logger(trt)
    builder = trt.Builder(logger)
    network = builder.create_network(1 << int(trt.NetworkDefinitionCreationFlag.STRONGLY_TYPED))
    parser = trt.OnnxParser(network, logger)
    if not parser.parse_from_file(str(path)):
        faults = [parser.get_error(i).desc() for i in range(parser.num_errors)]
        reason = one_line(faults[0] if faults else logger.last)
        raise ModelError(f"{path}: TensorRT cannot read the model: {reason}")
    config = builder.create_builder_config()
    config.set_memory_pool_limit(trt.MemoryPoolType.WORKSPACE, _WORKSPACE_BYTES)
    config.progress_monitor = make_monitor(trt, note)
    if shapes:
        profile = builder.create_optimization_profile()
        for name, (least, usual, largest) in shapes.items():
            profile.set_shape(name, least, usual, largest)
        config.add_optimization_profile(profile)
    plan = builder.build_serialized_network(network, config)
    if plan is None:
        raise ModelError(f"{path}: TensorRT cannot build an engine: {logger.last}")
    return plan


def make_logger(trt: Any) -> Any:
    """Make a TensorRT logger that writes to our log; its attribute `last` is the newest error."""
    severity = trt.ILogger.Severity
    levels = {
        severity.INTERNAL_ERROR: logging.ERROR,
        severity.ERROR: logging.ERROR,
        severity.WARNING: logging.WARNING,
        severity.INFO: logging.DEBUG,
        severity.VERBOSE: logging.DEBUG,
    }

    class Logger(trt.ILogger):
        def __init__(self) -> None:
            trt.ILogger.__init__(self)
            self.last = "no reason given"

        def log(self, level: Any, message: str) -> None:
            if levels[level] == logging.ERROR:
                self.last = one_line(message)
            if level != severity.VERBOSE:
                log.log(levels[level], "%s", one_line(message, 1000))

    return Logger()


def make_monitor(trt: Any, note: Callable[[str], None]) -> Any:
    """Make a TensorRT progress monitor that notes lines such as `45% of building engine`."""
    lock = threading.Lock()  # TensorRT reports from several threads
    phases: dict[str, list[Any]] = {}  # see `progress_text`; outermost first

    class Monitor(trt.IProgressMonitor):
        def __init__(self) -> None:
            trt.IProgressMonitor.__init__(self)

        def phase_start(self, phase_name: str, parent_phase: str | None, num_steps: int) -> None:
            with lock:
                phases[phase_name] = [parent_phase, max(1, num_steps), 0]
                note(progress_text(phases))

        def step_complete(self, phase_name: str, step: int) -> bool:
            with lock:
                if phase_name in phases:
                    phases[phase_name][_DONE] = step + 1  # counted from 0
                note(progress_text(phases))
            return True  # go on

        def phase_finish(self, phase_name: str) -> None:
            with lock:
                phases.pop(phase_name, None)
                note(progress_text(phases))

    return Monitor()


def progress_text(phases: Mapping[str, Sequence[Any]]) -> str:
    """Return the outermost phase and its share done, inner phases included; "" if there is none.

    Args:
        phases: (name of the parent or None, number of steps, steps done) by name.
    """

    def share(name: str) -> float:
        _, steps, done = phases[name]
        inner = [share(child) for child, phase in phases.items() if phase[_PARENT] == name]
        return min(1.0, (done + max(inner, default=0.0)) / steps)

    root = next((name for name, phase in phases.items() if phase[_PARENT] is None), None)
    return "" if root is None else f"{share(root):.0%} of {root.lower()}"


class TensorrtSession:
    """A session that runs an engine, with the part of onnxruntime's interface that is used here.

    Inputs and outputs are float32, as `onnx_file` has checked. Different threads may bind and run.

    Args:
        owners: TensorRT objects that own `engine`; the session keeps them alive.
        engine: engine of TensorRT.
    """

    def __init__(self, owners: Any, engine: Any, device: Device) -> None:
        self._kept = (owners, engine)  # both must outlive the context
        self.device = device
        self._context = engine.create_execution_context()
        if self._context is None:
            raise ModelError("TensorRT: not enough GPU memory for the engine; free GPU memory")
        self._lock = threading.Lock()

    def get_providers(self) -> list[str]:
        return ["tensorrt"]

    def run(self, names: Sequence[str], feeds: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        """Return the named outputs for these inputs (float32, contiguous)."""
        with self._lock:
            for name, array in feeds.items():
                self._set_shape(name, array.shape)
            shapes = {name: tuple(self._context.get_tensor_shape(name)) for name in names}
        return list(self.bind(feeds, shapes, live=()).run())

    def bind(
        self, inputs: Mapping[str, np.ndarray], outputs: Shapes, live: Sequence[str]
    ) -> BoundSession:
        return TensorrtBound(self, inputs, outputs, live)

    def execute(self, shapes: Shapes, addresses: Mapping[str, int]) -> None:
        """Enqueue one run on the stream; the caller holds `exclusive`."""
        for name, shape in shapes.items():
            self._set_shape(name, shape)
        for name, address in addresses.items():
            self._context.set_tensor_address(name, address)
        if not self._context.execute_async_v3(self.device.stream):
            raise RuntimeError("TensorRT could not run the engine; see the log for why")

    def _set_shape(self, name: str, shape: Sequence[int]) -> None:
        if not self._context.set_input_shape(name, tuple(shape)):
            raise ValueError(
                f"TensorRT: input {name} of shape {tuple(shape)} is outside the shapes that the "
                "engine was built for: search for fewer objects at once"
            )

    @property
    def exclusive(self) -> threading.Lock:
        """The lock that a caller holds during a run."""
        return self._lock


class TensorrtBound:
    """A session bound to device buffers for one set of inputs (`BoundSession`).

    Outputs are copied to arrays whose pages are locked in memory (pinned).
    """

    def __init__(
        self,
        session: TensorrtSession,
        inputs: Mapping[str, np.ndarray],
        outputs: Shapes,
        live: Sequence[str],
    ) -> None:
        self._session = session
        device = session.device
        device.use()
        self._shapes = {name: array.shape for name, array in inputs.items()}
        self._results = {name: np.empty(shape, np.float32) for name, shape in outputs.items()}
        arrays = {**inputs, **self._results}
        self._buffers = {name: device.allocate(array.nbytes) for name, array in arrays.items()}
        self._addresses = {name: buffer.pointer for name, buffer in self._buffers.items()}
        self._live = [(self._buffers[name], inputs[name]) for name in live]
        for array in (*(array for _, array in self._live), *self._results.values()):
            device.pin(array)
        for name, array in inputs.items():
            device.upload(self._buffers[name], array)
        device.wait()

    def run(self) -> Sequence[np.ndarray]:
        device = self._session.device
        with self._session.exclusive:
            device.use()
            for buffer, array in self._live:
                device.upload(buffer, array)
            self._session.execute(self._shapes, self._addresses)
            for name, array in self._results.items():
                device.download(array, self._buffers[name])
            device.wait()
        return list(self._results.values())
