"""Write a fitted forecaster as C, as an FMU or as ONNX."""
