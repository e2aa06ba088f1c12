"""The runtime of models: cards, files, onnxruntime, TensorRT, model servers (KServe, version 2).

Tensors in and out: only a card knows the purpose of a model. A server is not trusted: its answers
are checked like a file from a stranger.
"""
