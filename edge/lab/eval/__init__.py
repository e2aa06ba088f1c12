"""Measures the whole: episodes in houses, task planners, translations, recorded runs.

Everything here runs the parts of the service as they are; nothing that a robot runs needs it.
"""
