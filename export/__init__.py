"""gapmes.export: torch to ONNX, verification against torch, quantisation."""

from gapmes import service as service  # before onnxruntime: this switches its telemetry off
