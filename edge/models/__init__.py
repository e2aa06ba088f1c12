"""`edge models`: what models there are, how they are had and made, whether they are sound.

Commands only: the service reads cards and runs models by `edge.perception`.
"""
