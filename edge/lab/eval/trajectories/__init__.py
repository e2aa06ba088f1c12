"""`edge eval trajectories`: compare trajectories written for instructions with references.

`references` makes tasks with reference trajectories, `outdoor` and `episodes` their places.
`methods` has the compared methods, `outcomes` the results, `tables` and `pictures` the report,
`run` the command.
"""
