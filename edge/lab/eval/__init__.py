"""Evaluation: episodes in houses, task planners, translators, trajectories, endurance runs.

The code here runs the unchanged parts of the service. A robot needs none of it.
"""
