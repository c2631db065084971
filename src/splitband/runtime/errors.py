"""Define the error for what a user gave."""

from __future__ import annotations


class InputError(ValueError):
    """Report what a user gave that cannot be used.

    The message is one line that names the argument, the rule and the value. Any other error, a
    `ValueError` of a library included, is a defect: the command line shows it with its traceback.
    """


def missing(what: str, package: str, extra: str) -> InputError:
    """Return the error for an optional package that is not installed, with the command for it.

    The quotes are those that the shells of every system understand.
    """
    return InputError(f'{what} needs {package}: pip install "splitband[{extra}]"')


def one_line(error: BaseException) -> str:
    """Return the message of another library's error on one line."""
    return " ".join(str(error).split())[:300] or type(error).__name__
