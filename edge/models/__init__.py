"""`edge models`: what models there are, how they are had and made, whether they are sound.

Nothing here runs beside the loop: a running service is asked over the bus (`use`).
"""
