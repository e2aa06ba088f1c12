"""Simulated houses and robots, which speak to the service as real sensors do.

The service learns of a world by messages only; what no robot could tell has topics of its own.
"""
