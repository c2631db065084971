"""Define the error for a user's input."""

from __future__ import annotations


class InputError(ValueError):
    """An invalid input of the user.

    The message names the argument, the rule and the value on one line. Any other error, a
    `ValueError` of a library included, is a defect: the command line shows its traceback.
    """


def missing(what: str, package: str, extra: str) -> InputError:
    """Return the error for a missing package, with a command for the shells of all systems."""
    return InputError(f'{what} needs {package}: pip install "splitband[{extra}]"')


def one_line(error: BaseException) -> str:
    """Return the message of another library's error on one line."""
    return " ".join(str(error).split())[:300] or type(error).__name__
