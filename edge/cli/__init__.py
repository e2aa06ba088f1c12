"""The command `edge`: parsers, thin handlers, and the output on a terminal.

Nothing here is needed on the robot: every command calls a function of another package.
"""
