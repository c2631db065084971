"""Rules that no linter holds."""

import ast
import re
from pathlib import Path

import splitband

SOURCE = Path(splitband.__file__).parent
SYSTEM = SOURCE / "runtime/system.py"
OF_ONE_SYSTEM = re.compile(
    r"\bsys\.platform\b|\bos\.name\b|\bhasattr\((os|signal|sys)\b|\bCDLL\(None|\bresource_tracker\b"
    r"|\bos\.(fork|killpg|\w*pgid|setsid|get\w*uid|wait\w*|nice|mkfifo|sched_\w+|sysconf|posix_\w+"
    r"|uname)\("
    r"|\bsignal\.(SIG(KILL|HUP|USR|ALRM|CHLD|PIPE|QUIT|STOP|CONT|_BLOCK|_UNBLOCK|_SETMASK)"
    r"|pthread_|alarm|setitimer|pause)"
    r"|^\s*(import|from) (fcntl|grp|posix|pty|pwd|resource|syslog|termios|tty)\b"
    r"|[\"']/(tmp|proc|dev|usr)\b"
)


def test_errors_about_input_have_a_class_of_their_own() -> None:
    """The command line tells bad input from a defect by it."""
    others = [
        f"{path.relative_to(SOURCE)}:{node.lineno}"
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Raise) and ast.unparse(node).startswith("raise ValueError")
    ]
    assert not others


def test_one_module_knows_the_operating_system() -> None:
    """`make check` reads it as on Windows and on macOS."""
    others = [
        f"{path.relative_to(SOURCE)}:{number}"
        for path in SOURCE.rglob("*.py")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if path != SYSTEM and OF_ONE_SYSTEM.search(line)
    ]
    assert not others
