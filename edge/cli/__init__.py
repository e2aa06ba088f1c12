"""The `edge` command: parsers, thin handlers, and what a terminal shows.

Nothing that the robot needs lives here: every command is a function of another package.
"""
