"""What models run on: onnxruntime on a CPU or GPU, TensorRT, and buffers on the device."""
