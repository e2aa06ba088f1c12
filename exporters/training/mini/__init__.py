"""The small detector of our own, made from nothing but code and a seed.

`houses` lays out random houses and furnishes them, `looks` says what one may call a thing,
`views` takes pictures, `batches` cuts and disturbs them and thinks up phrases, true and nearly
true; `net` is the network, `loss` what it is taught, `training` the loop; `export` writes
ONNX files and cards, `evaluate` measures them on houses that training never saw and says what they
must be able to do. The detector knows the built-in world (`edge.lab.sim.assemblies`) and nothing
else.
"""
