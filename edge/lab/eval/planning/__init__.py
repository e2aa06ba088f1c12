"""ViTL's task-level benchmark: mission planners on tasks in natural language.

`templates` makes the tasks, `planners` has the compared planners, `executor` runs one episode and
`sweep` all of them. The benchmark simulates no driving and no perception.
"""
