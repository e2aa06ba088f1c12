"""ViTL's task-level benchmark: mission planners on tasks in language, and what their robot meets.

`templates` makes the tasks, `planners` are what is compared, `executor` runs one episode and
`sweep` all of them. Nothing here drives or sees.
"""
