"""The commands of `edge models`: list, check, download, export and switch models.

The service does not use this package: it reads cards and runs models with `edge.perception`.
"""
