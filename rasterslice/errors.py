"""The errors that a user can cause, each with the exit code of the command line.

Every message names the thing, its value, the limit and the remedy, in one line.
"""


class RasterSliceError(Exception):
    """Base of all errors that are reported in one line, without a traceback."""

    exit_code = 1


class UsageError(RasterSliceError):
    """Parameters, folders, memory, thickness: what the user asked for cannot be done."""

    exit_code = 2


class ModelError(RasterSliceError):
    """A model file is missing, unreadable, empty or damaged."""

    exit_code = 3


class DeviceError(RasterSliceError):
    """No usable OpenCL device, or one that fails its self-test."""

    exit_code = 5


def counted(number: int, word: str) -> str:
    """Return how many of something there are, in words: ``1 facet``, ``2 facets``."""
    return f"{number} {word}{'s' * (number != 1)}"
