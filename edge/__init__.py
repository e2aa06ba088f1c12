"""Edge inference service for vision-language navigation."""

import os

__version__ = "0.1.0"

# Official builds of onnxruntime (from 1.29) collect model, processor, device and paths, and send
# them to the vendor. onnxruntime reads this variable when it is loaded. Every process of ours
# loads this module first, and child processes inherit the variable.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
