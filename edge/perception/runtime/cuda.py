"""Access to a GPU: name and capability from the driver, memory through NVIDIA's `cuda-bindings`."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np

from edge.perception.runtime.model_file import ModelError

_CAPABILITY = (75, 76)  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR, _MINOR in cuda.h


def load() -> Any:
    """Import `cuda.bindings.runtime`; raise ModelError if it is not installed."""
    try:
        from cuda.bindings import runtime
    except ImportError:
        raise ModelError(
            "cuda-bindings is not installed: pip install edge-vln[tensorrt], or choose other "
            "perception.detector.providers"
        ) from None
    return runtime


class Device:
    """One GPU with one stream, which is a queue of work for the GPU.

    `upload` and `download` only enqueue a copy: the arrays must not change until `wait` returns.

    Args:
        index: `perception.detector.device_id`.
        cuda: the module that `load` returns, or a stand-in for tests; None: `load` it.

    Raises:
        ModelError: no `cuda-bindings`, no driver, or no such GPU.
    """

    def __init__(self, index: int, cuda: Any = None) -> None:
        self._cuda = cuda = load() if cuda is None else cuda
        self.index = index
        try:
            (count,) = self._call("cudaGetDeviceCount")
        except RuntimeError as error:
            raise ModelError(
                f"no CUDA device: {error}; check the driver, or choose other "
                "perception.detector.providers"
            ) from None
        if index >= count:
            raise ModelError(
                f"perception.detector.device_id: {index}, but there are {count} GPUs here, "
                "numbered from 0"
            )
        self.use()
        self._pinned: weakref.WeakValueDictionary[int, np.ndarray] = weakref.WeakValueDictionary()
        (self._stream,) = self._call("cudaStreamCreate")
        _free_with(self, cuda.cudaStreamDestroy, self._stream)

    @property
    def stream(self) -> int:
        """Handle of the stream."""
        return int(self._stream)

    def use(self) -> None:
        """Make this GPU the calling thread's device."""
        self._call("cudaSetDevice", self.index)

    def allocate(self, nbytes: int) -> DeviceBuffer:
        """Allocate memory on the device, freed with the returned object."""
        (pointer,) = self._call("cudaMalloc", nbytes)
        return DeviceBuffer(int(pointer), nbytes, self._cuda)

    def pin(self, array: np.ndarray) -> None:
        """Lock an array's pages in memory, for direct copies, until the array is freed.

        If the system refuses, copies are slower.
        """
        address = array.ctypes.data
        if address in self._pinned:
            return
        (error,) = self._cuda.cudaHostRegister(address, array.nbytes, 0)
        if error != self._cuda.cudaError_t.cudaSuccess:
            self._cuda.cudaGetLastError()  # clear it, or the next check would report it
        else:
            self._pinned[address] = array
            _free_with(array, self._cuda.cudaHostUnregister, address)

    def upload(self, buffer: DeviceBuffer, array: np.ndarray) -> None:
        """Enqueue a copy of a contiguous array to the buffer."""
        kind = self._cuda.cudaMemcpyKind.cudaMemcpyHostToDevice
        self._copy(buffer.pointer, array.ctypes.data, array.nbytes, kind)

    def download(self, array: np.ndarray, buffer: DeviceBuffer) -> None:
        """Enqueue a copy of the buffer to a contiguous array; call `wait` before reading it."""
        kind = self._cuda.cudaMemcpyKind.cudaMemcpyDeviceToHost
        self._copy(array.ctypes.data, buffer.pointer, array.nbytes, kind)

    def wait(self) -> None:
        """Wait until all enqueued work is done."""
        self._call("cudaStreamSynchronize", self._stream)

    def _copy(self, to: int, source: int, nbytes: int, kind: Any) -> None:
        self._call("cudaMemcpyAsync", to, source, nbytes, kind, self._stream)

    def _call(self, name: str, *arguments: object) -> tuple:
        """Call a CUDA function; return its values without the error, which raises RuntimeError."""
        error, *values = getattr(self._cuda, name)(*arguments)
        if error != self._cuda.cudaError_t.cudaSuccess:
            _, text = self._cuda.cudaGetErrorString(error)
            raise RuntimeError(f"CUDA function {name} failed: {text.decode()}")
        return tuple(values)


class DeviceBuffer:
    """Bytes on a device.

    Attributes:
        pointer: address of the first byte.
    """

    def __init__(self, pointer: int, nbytes: int, cuda: Any) -> None:
        self.pointer, self.nbytes = pointer, nbytes
        _free_with(self, cuda.cudaFree, pointer)


def _free_with(owner: object, free: Callable[[Any], object], resource: Any) -> None:
    """Free the resource with its owner; at the end of the process the driver does it."""
    weakref.finalize(owner, free, resource).atexit = False


def gpu_of(device_id: int, section: str = "perception.detector") -> tuple[str, str]:
    """Return a GPU's name and compute capability, such as `Orin` and `8.7`, from the driver.

    The driver is asked because onnxruntime does not report them. `section` is that of the
    configuration with the number, for messages.

    Raises:
        ModelError: no driver or no such GPU.
    """
    try:
        cuda = ctypes.CDLL("libcuda.so.1")
    except OSError:
        raise ModelError(
            f"no CUDA driver (libcuda.so.1): choose other {section}.providers"
        ) from None
    device = ctypes.c_int()
    failed = cuda.cuInit(0) or cuda.cuDeviceGet(ctypes.byref(device), device_id)
    if failed:
        raise ModelError(f"{section}.device_id: no GPU {device_id} (CUDA error {failed})")
    name, value, capability = ctypes.create_string_buffer(256), ctypes.c_int(), []
    cuda.cuDeviceGetName(name, len(name), device)
    for attribute in _CAPABILITY:
        cuda.cuDeviceGetAttribute(ctypes.byref(value), attribute, device)
        capability.append(str(value.value))
    return name.value.decode(errors="replace"), ".".join(capability)
