"""The base of errors that a user can cause."""


class UserError(Exception):
    """Its message is one line: what is wrong, where, and what to do."""


class Stopped(UserError):
    """Told to stop while waiting for something: no failure."""
