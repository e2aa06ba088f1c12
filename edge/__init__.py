"""Edge inference service for vision-language navigation."""

import os

__version__ = "0.1.0"

# onnxruntime's official builds (1.29 on) note model, processor, device and paths in the user's
# cache, and send them home. It looks at this when it is loaded, hence here: this module comes
# before all others in every process of ours, and their children inherit it.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
