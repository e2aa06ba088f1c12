"""`edge models`: what models there are, how they are had and made, whether they are sound."""
