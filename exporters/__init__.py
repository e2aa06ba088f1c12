"""Tools to export models: torch → ONNX → fewer bits, with a parity check after each step.

Nothing in `edge` imports this package: torch and ultralytics (AGPL-3.0) stay off the robot.
"""

import edge  # noqa: F401 - switches onnxruntime's telemetry off before that is loaded
