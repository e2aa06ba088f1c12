"""What models run on: onnxruntime on a CPU or GPU, TensorRT, and buffers on the device.

Tensors in and out: nothing here knows what a model is for.
"""
