"""`edge trajectory`: one instruction in one place, from sensor data to a refined trajectory.

It writes pictures and a page. `edge.lab.eval.trajectories` evaluates many instructions.
"""
