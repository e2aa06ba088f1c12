"""Language models, with eyes or without, that run here from the ONNX files that others publish.

What a model is fed and how is read from its own files; what it is asked is in
`edge.perception.scoring.choice`.
"""
