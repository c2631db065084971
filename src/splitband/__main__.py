"""`splitband` and `python -m splitband`: the command line, which Ctrl-C may stop while it loads."""

import sys


def main() -> int:
    """The exit status of the command line."""
    try:
        from splitband.cli import main as run  # noqa: PLC0415  takes seconds, and may be stopped
    except KeyboardInterrupt:
        print("error: stopped before anything was begun", file=sys.stderr)
        return 130
    return run()


if __name__ == "__main__":
    sys.exit(main())
