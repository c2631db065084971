"""Run the command line as `splitband` and `python -m splitband`; Ctrl-C may stop its loading."""

import sys
import time

_BEGAN = time.time() - time.process_time()
"""When the process began: what the interpreter has done before is its CPU time so far."""


def main() -> int:
    """Return the exit status of the command line."""
    try:
        from splitband.cli import main as run  # noqa: PLC0415  takes seconds, and may be stopped
    except KeyboardInterrupt:
        print("error: stopped before anything was begun", file=sys.stderr)
        return 130
    return run(began=_BEGAN)


if __name__ == "__main__":
    sys.exit(main())
