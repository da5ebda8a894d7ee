"""gapmes.export: torch to ONNX, verification against torch, quantisation."""
