"""Simulator, evaluation, benchmarks, reports and the reference controller. Not used on the robot.

No package outside `edge.lab` imports it, except the CLI, which imports it lazily. Its packages need
the extra `lab`.
"""
