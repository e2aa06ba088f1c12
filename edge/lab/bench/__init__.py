"""Benchmarks of `edge bench`.

`service` measures the entire service on a recording, `swap` a change of the model meanwhile. All
other modules are `edge bench --models`: they measure every variant of a family of models on the
same frames (VL-Nav section V.D). Each variant is timed in its own process. The benchmark only
reports; it does not choose a model.
"""
