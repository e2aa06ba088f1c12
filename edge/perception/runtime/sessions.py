"""Opens the session that runs a model, on exactly the configured providers.

A provider is onnxruntime's name (`CPUExecutionProvider`, `CUDAExecutionProvider`,
`TensorrtExecutionProvider`), or `tensorrt` alone, which is TensorRT without onnxruntime.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edge.errors import UserError
from edge.perception.runtime import tensorrt
from edge.perception.runtime.engines import EngineOptions, cached_engine
from edge.perception.runtime.model_file import ModelError
from edge.text import one_line

CPU_ONLY = ("CPUExecutionProvider",)
TENSORRT = "tensorrt"  # provider: TensorRT without onnxruntime
ORT_TENSORRT = "TensorrtExecutionProvider"  # provider: TensorRT by onnxruntime
TENSORRT_PROVIDERS = {TENSORRT, ORT_TENSORRT}

DTYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(bool)": np.bool_,
}
"""onnxruntime's name of a tensor type → NumPy's type."""

RECIPE = 1
"""Version of TensorRT's builder settings in `provider_options`; increase it when they change."""


def open_session(
    path: Path,
    providers: Sequence[str],
    threads: int,
    device_id: int = 0,
    engine: EngineOptions | None = None,
    key: str | None = None,
) -> Any:
    """Open a session that runs on exactly the named providers.

    The session is onnxruntime's, or one of TensorRT with the same `run` and `get_providers`;
    `edge.perception.runtime.binding.bind` takes both kinds.

    Args:
        path: the ONNX file.
        providers: names, in order of preference.
        threads: number of CPU threads.
        device_id: number of the GPU.
        engine: options of the model for TensorRT, not used by other providers; by default an `fp32`
            model of fixed shapes.
        key: configuration key of the providers, for messages; None: that in the engine's section.

    Raises:
        ModelError: a package or provider is missing, or the file is no model.
    """
    engine = engine or EngineOptions(path.stem, "fp32")
    key = key or f"{engine.section}.providers"
    if engine.precision == "int8-cpu" and TENSORRT_PROVIDERS.intersection(providers):
        raise ModelError(
            f"model {engine.model}: quantized for CPUs (int8-cpu, asymmetric), which TensorRT "
            "cannot run; choose the model's int8-trt or fp16 variant"
        )
    check_providers(providers, key)
    if TENSORRT in providers:
        return tensorrt.open_engine(path, device_id, engine)
    return _open_onnxruntime(path, providers, threads, device_id, engine, key)


def open_onnxruntime_session(
    path: Path, providers: Sequence[str], threads: int, device_id: int, engine: EngineOptions
) -> Any:
    """Open a session of onnxruntime; see `open_session`.

    Raises:
        ModelError: see `open_session`; also if the provider is `tensorrt`, which has no session of
            onnxruntime.
    """
    if TENSORRT in providers:
        raise ModelError(
            f"{engine.section}.providers: {TENSORRT!r} runs only detectors; name onnxruntime's "
            f"{ORT_TENSORRT} instead"
        )
    return open_session(path, providers, threads, device_id, engine)


def check_providers(providers: Sequence[str], key: str, ask_onnxruntime: bool = True) -> None:
    """Check that this installation has the providers.

    Args:
        providers: names.
        key: configuration key of the providers, for messages.
        ask_onnxruntime: False: do not import onnxruntime (slow), so its list of providers is not
            checked.

    Raises:
        ModelError: there are none, or a package or a provider is missing.
    """
    if not providers:
        raise ModelError(f"{key}: empty; name at least one provider")
    if TENSORRT in providers:
        if len(providers) > 1:
            raise ModelError(
                f"{key}: {TENSORRT!r} cannot be combined with other providers; name only one"
            )
        tensorrt.load()
        return
    missing_package = ModelError(
        "onnxruntime is not installed: pip install edge-vln[cpu] (or [gpu])"
    )
    if not ask_onnxruntime:
        if importlib.util.find_spec("onnxruntime") is None:
            raise missing_package
        return
    try:
        import onnxruntime as ort
    except ImportError as error:
        if error.name == "onnxruntime" and isinstance(error, ModuleNotFoundError):
            raise missing_package from None
        raise ModelError(f"onnxruntime cannot be imported: {one_line(error)}") from None
    available = ort.get_available_providers()
    for provider in providers:
        if provider not in available:
            raise ModelError(
                f"{key}: {provider!r} is not available here (available: {', '.join(available)})"
            )


def _open_onnxruntime(
    path: Path,
    providers: Sequence[str],
    threads: int,
    device_id: int,
    engine: EngineOptions,
    key: str,
) -> Any:
    """Open a session of onnxruntime; see `open_session`. TensorRT's engine comes from the cache."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Threads that wait must not take a core from the loop.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    options.log_severity_level = 3  # errors only

    def load(folder: Path) -> Any:
        with_options = [(p, provider_options(p, device_id, engine, folder)) for p in providers]
        return _load(ort, path, options, with_options, key)

    if ORT_TENSORRT not in providers:
        return load(engine.folder)
    # The first load writes the engine into the cache's folder; the last one reads it there.
    built = cached_engine(
        path,
        engine,
        lambda folder, _: load(folder),
        device_id,
        builder=f"onnxruntime {ort.__version__}",
        tensorrt=tensorrt_version(key),
        recipe=RECIPE,
    )
    return load(built)


def _load(
    ort: Any, path: Path, options: Any, providers: list[tuple[str, dict[str, str]]], key: str
) -> Any:
    """Make onnxruntime's session; raise ModelError if a provider did not start."""
    try:
        # onnxruntime's fallback would print, and use other providers than those named.
        session = ort.InferenceSession(str(path), options, providers=providers, enable_fallback=0)
    except Exception as error:  # onnxruntime raises many types
        raise ModelError(
            f"{path}: onnxruntime cannot load the model: {short_reason(error)}"
        ) from None
    # A provider that fails to start is only logged by onnxruntime, which then uses the CPU.
    if missing := [p for p, _ in providers if p not in session.get_providers()]:
        raise ModelError(
            f"{path}: {', '.join(missing)} did not start; onnxruntime would run on "
            f"{', '.join(session.get_providers())} instead: check the driver, or change "
            f"{key}"
        )
    return session


@contextlib.contextmanager
def raise_as_model_error(what: str) -> Iterator[None]:
    """Turn any error of a model or its runtime within the block into a ModelError of one line."""
    try:
        yield
    except UserError:
        raise
    except Exception as error:  # onnxruntime raises many types, CUDA RuntimeError
        reason = one_line(error) or type(error).__name__
        raise ModelError(f"{what}: {reason}") from None


def short_reason(error: Exception) -> str:
    """Return onnxruntime's reason without the path and source location in front of it."""
    text = " ".join(str(error).split()) or type(error).__name__
    # Such as "[ONNXRuntimeError] : 7 : INVALID_PROTOBUF : "
    text = re.sub(r"^\[ONNXRuntimeError\] : \d+ : \w+ : ", "", text)
    # Such as "Load model from /tmp/a.onnx failed:"
    text = re.sub(r"^.* failed: ?", "", text)
    # Such as "/onnxruntime_src/core/graph/model.cc:181 onnxruntime::Model::Model(…) "
    text = re.sub(r"/onnxruntime_src/\S+:\d+ .*?\) ", "", text)
    return one_line(text.rpartition(", Error ")[2])


def provider_options(
    provider: str, device_id: int, engine: EngineOptions, folder: Path
) -> dict[str, str]:
    """Return the options of an onnxruntime provider; empty if it needs none.

    The TensorRT provider builds weakly typed networks: the flags allow the types that are in the
    file. Nodes that quantize and dequantize (Q/DQ) in the file replace a calibration table.
    https://onnxruntime.ai/docs/execution-providers/TensorRT-ExecutionProvider.html
    """
    if provider == "CUDAExecutionProvider":
        return {"device_id": str(device_id)}
    if provider != ORT_TENSORRT:
        return {}
    options = {
        "device_id": str(device_id),
        "trt_engine_cache_enable": "True",
        "trt_engine_cache_path": str(folder),
        "trt_timing_cache_enable": "True",
        "trt_timing_cache_path": str(engine.folder),
        "trt_fp16_enable": str(engine.precision in ("fp16", "int8-trt")),
        "trt_int8_enable": str(engine.precision == "int8-trt"),
    }
    # Such as trt_profile_min_shapes: "txt_feats:1x1x512".
    for index, end in enumerate(("min", "opt", "max")):
        shapes = (f"{n}:{'x'.join(map(str, s[index]))}" for n, s in engine.shapes.items())
        if text := ",".join(shapes):
            options[f"trt_profile_{end}_shapes"] = text
    return options


def tensorrt_version(key: str) -> str:
    """Return the version of TensorRT that onnxruntime will load.

    The version comes from Python's package, else from the library. `key` is the configuration key
    of the providers, for messages.

    Raises:
        ModelError: TensorRT is not installed.
    """
    if importlib.util.find_spec("tensorrt") is not None:
        import tensorrt  # loads its libraries, so that onnxruntime finds them

        return str(tensorrt.__version__)
    for name in ("libnvinfer.so.10", "libnvinfer.so.11", "libnvinfer.so"):
        try:
            return str(ctypes.CDLL(name).getInferLibVersion())
        except (OSError, AttributeError):
            continue
    raise ModelError(f"TensorRT's libnvinfer is not found: install TensorRT, or choose other {key}")
