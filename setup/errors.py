"""Error of the set-up: one line for the user."""


class SetupError(Exception):
    """Something the user can put right; the message says what, where, and what to do.

    Args:
        message: one line for stderr.
        exit_code: 2 unless told.
    """

    def __init__(self, message: str, exit_code: int = 2) -> None:
        super().__init__(message)
        self.exit_code = exit_code
