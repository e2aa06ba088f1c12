"""Export-time tools: torch → ONNX → INT8, each step with a parity check.

Nothing in `edge` imports this package: torch and ultralytics (AGPL-3.0) stay off the robot.
"""

import edge  # noqa: F401 - switches onnxruntime's telemetry off before that is loaded
