"""Our own small detector, made from code and a seed only.

`houses` lays out and furnishes random houses, `looks` defines the words for an object, `views`
renders images, `batches` crops and augments them and makes true and nearly true phrases. `net` is
the network, `loss` its loss, `training` the loop. `export` writes ONNX files and cards, and
`evaluate` measures them on held-out houses against the required figures. The detector knows only
the built-in world (`edge.lab.sim.assemblies`).
"""
