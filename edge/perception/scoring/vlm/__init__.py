"""Published language models, with or without image input, that run here from their ONNX files.

The model's own files define its input. The questions are in `edge.perception.scoring.choice`.
"""
