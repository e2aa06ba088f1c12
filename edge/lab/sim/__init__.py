"""Simulated worlds and robots, which send the service the same messages as real sensors.

The service learns about a world only from these messages. Ground truth has its own topics.
"""
