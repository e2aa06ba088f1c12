"""`edge eval trajectories`: compare trajectories written for instructions with references.

`meaning` and `episodes` make places, tasks and reference trajectories. `methods` has the compared
methods, `outcomes` the results, `tables` and `pictures` the report, `run` the command.
"""
