"""gapmes.service.network: the network as an ONNX file: what it says of itself, its weights, running it."""
