"""Simulated houses and robots, which speak to the service as real sensors do.

Nothing that runs on a robot imports it.
"""
