"""The one error that users cause: the command line turns it into a sentence and exit code 2."""


class LuxloopError(ValueError):
    """Bad input; the message is one sentence that names the file, the key or line, and the remedy."""
