"""Simulation, evaluation, benches, reports and the reference controller: never on the robot's path.

Nothing outside imports it; the CLI does so lazily. Its packages need the extra `lab`.
"""
