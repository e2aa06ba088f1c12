"""Sessions with their buffers bound once, so that an image costs no allocation here.

`bind` chooses by the session's device. On the CPU, inputs and outputs are NumPy arrays that
onnxruntime reads and writes in place. On CUDA they are onnxruntime's values on the device, and
only changed inputs are uploaded. Sessions of TensorRT (`edge.perception.runtime.tensorrt`) and of a
server (`kserve.py`) bind themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

DEVICES = {
    "CUDAExecutionProvider": "cuda",
    "TensorrtExecutionProvider": "cuda",
    "tensorrt": "itself",
    "kserve": "itself",
}
"""Place of a provider's buffers; for providers that are not listed, it is the host's memory.

`itself`: the session has a method `bind`."""

Shapes = Mapping[str, tuple[int, ...]]
"""Shape of each tensor, by name."""


class BoundSession(Protocol):
    """A session with its inputs and outputs."""

    def run(self) -> Sequence[np.ndarray]:
        """Run once; return the outputs in the order they were named, valid until the next run."""
        ...


def bind(
    session: Any, inputs: Mapping[str, np.ndarray], outputs: Shapes, live: Sequence[str]
) -> BoundSession:
    """Bind a session's float32 inputs and outputs.

    Args:
        session: session of onnxruntime, TensorRT or a server.
        inputs: contiguous float32 arrays by name; the bound session keeps them.
        outputs: shapes of the outputs for these inputs.
        live: names of inputs whose arrays the caller fills again before each run. All others are
            read only once, now.
    """
    provider = session.get_providers()[0]
    device = DEVICES.get(provider, "cpu")
    if device == "itself":
        return session.bind(inputs, outputs, live)
    if device == "cpu":
        return HostBound(session, inputs, outputs)
    index = int(session.get_provider_options()[provider].get("device_id", 0))
    return DeviceBound(session, inputs, outputs, live, device, index)


class HostBound:
    """A session on the CPU: onnxruntime reads and writes the host's arrays in place."""

    def __init__(self, session: Any, inputs: Mapping[str, np.ndarray], outputs: Shapes) -> None:
        self._session, self._inputs = session, inputs
        self._outputs = [np.empty(shape, np.float32) for shape in outputs.values()]
        self._binding = binding = session.io_binding()
        for name, array in inputs.items():
            binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        for name, array in zip(outputs, self._outputs, strict=True):
            binding.bind_output(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)

    def run(self) -> Sequence[np.ndarray]:
        self._binding.synchronize_inputs()
        self._session.run_with_iobinding(self._binding)
        self._binding.synchronize_outputs()
        return self._outputs


class DeviceBound:
    """A session on a device: inputs are uploaded before a run, outputs downloaded after it."""

    def __init__(
        self,
        session: Any,
        inputs: Mapping[str, np.ndarray],
        outputs: Shapes,
        live: Sequence[str],
        device: str,
        index: int,
    ) -> None:
        import onnxruntime as ort

        values = ort.OrtValue
        self._session = session
        self._binding = binding = session.io_binding()
        on_device = {n: values.ortvalue_from_numpy(a, device, index) for n, a in inputs.items()}
        for name, value in on_device.items():
            binding.bind_ortvalue_input(name, value)
        self._live = [(on_device[name], inputs[name]) for name in live]
        # Keep the other inputs' memory on the device.
        self._fixed = [value for name, value in on_device.items() if name not in live]
        self._outputs = [
            values.ortvalue_from_shape_and_type(shape, np.float32, device, index)
            for shape in outputs.values()
        ]
        for name, value in zip(outputs, self._outputs, strict=True):
            binding.bind_ortvalue_output(name, value)

    def run(self) -> Sequence[np.ndarray]:
        for value, array in self._live:
            value.update_inplace(array)
        self._binding.synchronize_inputs()
        self._session.run_with_iobinding(self._binding)
        self._binding.synchronize_outputs()
        return [value.numpy() for value in self._outputs]
