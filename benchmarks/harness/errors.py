"""What is wrong with a command, as opposed to what is wrong with the code that it runs."""


class UsageError(ValueError):
    """A command that cannot be carried out, in one line."""
