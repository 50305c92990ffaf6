"""``ogmp-export``: a policy as ONNX, with all that a controller elsewhere needs."""
