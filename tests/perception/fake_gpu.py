"""Fakes of `cuda.bindings.runtime` and `tensorrt`, for tests of how they are called.

The fake GPU's memory is NumPy bytes; the fake engine adds its inputs `images` and `txt_feats`
into `boxes`, or has onnxruntime run its model on the CPU (`OnnxContext`). Only what
edge.perception calls is here, with the names and the order of arguments of cuda-bindings 12.9 and
TensorRT 10.3.
"""

from __future__ import annotations

import ctypes
import enum
import json
from types import SimpleNamespace

import numpy as np


class FakeCuda:
    """Fake of `cuda.bindings.runtime`.

    Attributes:
        memory: bytes by pointer.
        calls: names of the functions called.
        failing: functions that fail.
    """

    def __init__(self, gpus: int = 1) -> None:
        self.cudaError_t = enum.Enum("cudaError_t", "cudaSuccess cudaErrorNoDevice")
        self.cudaMemcpyKind = enum.Enum(
            "cudaMemcpyKind", "cudaMemcpyHostToDevice cudaMemcpyDeviceToHost"
        )
        self.gpus, self.memory, self.calls, self.failing = gpus, {}, [], set()
        self._next = 0x1000

    def _answer(self, name, *values):
        self.calls.append(name)
        if name in self.failing:
            return (self.cudaError_t.cudaErrorNoDevice, *values)
        return (self.cudaError_t.cudaSuccess, *values)

    def cudaGetErrorString(self, error):
        return self.cudaError_t.cudaSuccess, b"no CUDA-capable device is detected"

    def cudaGetLastError(self):
        return (self.cudaError_t.cudaSuccess,)

    def cudaGetDeviceCount(self):
        return self._answer("cudaGetDeviceCount", self.gpus)

    def cudaSetDevice(self, device):
        return self._answer("cudaSetDevice")

    def cudaStreamCreate(self):
        return self._answer("cudaStreamCreate", 77)

    def cudaStreamDestroy(self, stream):
        return self._answer("cudaStreamDestroy")

    def cudaStreamSynchronize(self, stream):
        return self._answer("cudaStreamSynchronize")

    def cudaMalloc(self, nbytes):
        if "cudaMalloc" in self.failing:
            return self._answer("cudaMalloc", 0)
        self._next += 0x100000
        self.memory[self._next] = np.zeros(nbytes, np.uint8)
        return self._answer("cudaMalloc", self._next)

    def cudaFree(self, pointer):
        del self.memory[pointer]
        return self._answer("cudaFree")

    def cudaHostRegister(self, pointer, nbytes, flags):
        return self._answer("cudaHostRegister")

    def cudaHostUnregister(self, pointer):
        return self._answer("cudaHostUnregister")

    def cudaMemcpyAsync(self, to, source, nbytes, kind, stream):
        if kind == self.cudaMemcpyKind.cudaMemcpyHostToDevice:
            self.memory[to][:nbytes] = np.frombuffer(ctypes.string_at(source, nbytes), np.uint8)
        else:
            ctypes.memmove(to, self.memory[source].tobytes(), nbytes)
        return self._answer("cudaMemcpyAsync")


class FakeTensorrt:
    """Fake of the module `tensorrt`.

    Attributes:
        built: shapes that an engine was built for, one entry per build.
        faults: errors of the parser.
        refuses: True if the builder makes no engine.
        unreadable: number of engines that do not load.
    """

    __version__ = "10.3.0"

    def __init__(self, cuda: FakeCuda) -> None:
        self.cuda, self.context = cuda, FakeContext
        self.built, self.faults, self.refuses, self.unreadable = [], [], False, 0
        self.flags = []
        self.NetworkDefinitionCreationFlag = enum.IntEnum(
            "NetworkDefinitionCreationFlag", "EXPLICIT_BATCH STRONGLY_TYPED", start=0
        )
        self.MemoryPoolType = enum.Enum("MemoryPoolType", "WORKSPACE")
        severity = enum.Enum("Severity", "INTERNAL_ERROR ERROR WARNING INFO VERBOSE")
        self.ILogger = type("ILogger", (), {"Severity": severity})
        self.IProgressMonitor = type("IProgressMonitor", (), {})

    def Builder(self, logger):
        def create_network(flags):
            self.flags.append(flags)
            return SimpleNamespace()

        def create_profile():
            shapes = {}
            return SimpleNamespace(
                shapes=shapes, set_shape=lambda name, *ends: shapes.update({name: ends})
            )

        def create_config():
            config = SimpleNamespace(
                profiles=[], progress_monitor=None, set_memory_pool_limit=lambda pool, size: None
            )
            config.add_optimization_profile = config.profiles.append
            return config

        def build(network, config):
            monitor = config.progress_monitor
            monitor.phase_start("Building Engine", None, 4)
            monitor.phase_start("Timing", "Building Engine", 2)
            assert monitor.step_complete("Timing", 0)
            monitor.phase_finish("Timing")
            monitor.step_complete("Building Engine", 0)
            monitor.phase_finish("Building Engine")
            if self.refuses:
                logger.log(self.ILogger.Severity.ERROR, "no kernel\nfor that")
                return None
            shapes = config.profiles[0].shapes if config.profiles else {}
            self.built.append(shapes)
            return json.dumps({"path": network.path, "shapes": shapes}).encode()

        return SimpleNamespace(
            create_network=create_network,
            create_optimization_profile=create_profile,
            create_builder_config=create_config,
            build_serialized_network=build,
        )

    def OnnxParser(self, network, logger):
        def parse(path):
            network.path = path
            return not self.faults

        return SimpleNamespace(
            parse_from_file=parse,
            num_errors=len(self.faults),
            get_error=lambda i: SimpleNamespace(desc=lambda: self.faults[i]),
        )

    def Runtime(self, logger):
        def deserialize(plan):
            if self.unreadable:
                self.unreadable -= 1
                logger.log(self.ILogger.Severity.ERROR, "out of memory")
                return None
            return SimpleNamespace(
                create_execution_context=lambda: self.context(self.cuda, **json.loads(plan))
            )

        return SimpleNamespace(deserialize_cuda_engine=deserialize)


class FakeContext:
    """Fake of an execution context: boxes = images + the sum of txt_feats."""

    def __init__(self, cuda: FakeCuda, path: str, shapes: dict) -> None:
        self.cuda, self.path, self.limits = cuda, path, shapes
        self.shapes, self.addresses = {}, {}

    def set_input_shape(self, name, shape):
        least, _, largest = self.limits.get(name, (shape, shape, shape))
        self.shapes[name] = shape
        return all(a <= n <= b for a, n, b in zip(least, shape, largest, strict=True))

    def get_tensor_shape(self, name):
        return self.shapes["images"]

    def set_tensor_address(self, name, pointer):
        self.addresses[name] = pointer
        return True

    def execute_async_v3(self, stream_handle):
        values = {n: self.cuda.memory[p].view(np.float32) for n, p in self.addresses.items()}
        values["boxes"][:] = values["images"] + values["txt_feats"].sum()
        return True


class OnnxContext(FakeContext):
    """Fake of an execution context that has onnxruntime do the work on the CPU."""

    def __init__(self, cuda: FakeCuda, path: str, shapes: dict) -> None:
        import onnxruntime

        super().__init__(cuda, path, shapes)
        self.session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        self.outputs = [output.name for output in self.session.get_outputs()]

    def get_tensor_shape(self, name):
        feed = {n: np.zeros(shape, np.float32) for n, shape in self.shapes.items()}
        return self.session.run([name], feed)[0].shape

    def execute_async_v3(self, stream_handle):
        memory = {n: self.cuda.memory[p].view(np.float32) for n, p in self.addresses.items()}
        feed = {name: memory[name].reshape(shape) for name, shape in self.shapes.items()}
        for name, array in zip(self.outputs, self.session.run(self.outputs, feed), strict=True):
            memory[name][:] = array.ravel()
        return True
