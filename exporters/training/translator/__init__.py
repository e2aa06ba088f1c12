"""Training of the small translator, which translates instructions to formulas.

`compose` makes sentences with their formulas, `data` turns them into batches, `net` is the network,
`training` the loop. `export` writes the ONNX file, `evaluate` measures it.
"""
