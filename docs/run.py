"""Run the blocks of the pages, and write below each what it gives: `python -m docs.run [PAGE ...]`.

A block that is run is a fence of `python` or `bash` with two comments below it. Between them stands
what it prints, and a line for each picture that it draws, whose file is fetched by its name:

    ```bash
    head -4 rig.csv
    ```
    <!--=output-->
    ```text
    ...
    ```
    ![The record](../img/run/rig.png)
    <!--/-->

The blocks of a page are one program in a new folder, which has the examples in it. Numbers may
differ by 2 %, times by anything: such outputs stay as they are. A page that has been run with this
code is not run again. With `--check` nothing is written, and outputs that differ are an error.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
DONE = DOCS / "_build/run"
"""Notes of which pages have been run with which code."""
BLOCK = re.compile(
    r"^```(?P<language>python|bash)\n(?P<code>(?:(?!```)[^\n]*\n)*)```\n"
    r"<!--=output-->\n(?P<output>.*?)^<!--/-->$",
    re.DOTALL | re.MULTILINE,
)
PICTURE = re.compile(r"^!\[.*?\]\((.*?)\)$", re.DOTALL | re.MULTILINE)
TEXT = re.compile(r"^```text\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
PROGRESS = re.compile(r"^(.*; \d+:\d\d so far|splitband: compiling kernels.*)\n", re.MULTILINE)
"""What a terminal shows for a moment."""
NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
TIME = re.compile(r"\d[\d.]*\s*(ms|s|min|seconds?|minutes?)\b|\d+:\d\d")
FRAME = re.compile(r"[\s─━│┃┏┓┡┩└┘┬┴┳┻╇┼├┤╭╮╰╯]+")
WIDTH = 88
"""Characters of a line that a page has room for."""
NOISE = 1e-6
"""Numbers below it are differences that rounding leaves."""
END = "-- the end of a block --"


def blocks(text: str) -> list[re.Match[str]]:
    """Return the blocks of a page that are run."""
    found = [*BLOCK.finditer(text)]
    if len(found) != text.count("<!--=output-->"):
        raise ValueError("<!--=output--> must stand right below a fence of python or bash")
    return found


def program(page: str) -> str:
    """Return the blocks of a page as one program."""
    # On one core the commands start no further processes, each of which would import torch again.
    lines = ["import os, subprocess", "if hasattr(os, 'sched_setaffinity'):"]
    lines += ["    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})"]
    for block in blocks(page):
        code = block["code"]
        if block["language"] == "bash":
            called = ["bash", "-euo", "pipefail", "-c", code]
            code = f"subprocess.run({called!r}, check=True, stdin=subprocess.DEVNULL)"
        lines += [code, f"print({END!r})"]
    return "\n".join(lines)


def executed(path: Path, page: str, fetch: bool) -> list[str]:
    """Return what each block of a page prints, and fetch its pictures.

    Raises
    ------
    ValueError : A block fails, or a picture is not drawn.
    """
    environment = os.environ | {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]),
        "PYTHONPATH": str(ROOT / "src"),
        **{"COLUMNS": str(WIDTH), "MPLBACKEND": "agg", "NO_COLOR": "1"},
    }
    with TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(ROOT / "examples", folder / "examples")
        script = Path(name, "page.py")
        script.write_text(program(page), encoding="utf-8")
        called = [sys.executable, "-u", str(script)]
        done = subprocess.run(
            called, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise ValueError(f"a block fails:\n{done.stdout[-2000:]}{done.stderr[-3000:]}")
        for block in blocks(page):
            for picture in PICTURE.findall(block["output"]):
                drawn, kept = folder / Path(picture).name, path.parent / picture
                if not drawn.is_file():
                    raise ValueError(f"no block draws {drawn.name}")
                if fetch:
                    kept.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy(drawn, kept)
    return [
        "\n".join(
            _wrapped(line.rstrip()) for line in PROGRESS.sub("", text).strip("\n").splitlines()
        )
        for text in done.stdout.split(f"{END}\n")[:-1]
    ]


def _wrapped(line: str) -> str:
    """Return a sentence on lines of a page's width, a row of a table or of a program as it is."""
    if len(line) <= WIDTH or "  " in line or FRAME.match(line) or line.startswith("/*"):
        return line
    return textwrap.fill(line, WIDTH, subsequent_indent="  ", break_long_words=False)


def alike(one: str, other: str) -> bool:
    """Return whether two outputs differ by no more than times and last places of numbers."""
    words = [FRAME.sub(" ", TIME.sub("TIME", _timeless(text))).strip() for text in (one, other)]
    if NUMBER.sub("N", words[0]) != NUMBER.sub("N", words[1]):
        return False
    return all(map(_close, *(NUMBER.findall(text) for text in words)))


def _timeless(text: str) -> str:
    """Return a table without the cells of columns that are headed by (s)."""
    lines = [re.split("[│┃]", line) for line in text.splitlines()]
    timed = {i for line in lines for i, cell in enumerate(line) if "(s)" in cell}
    return "\n".join(
        " ".join(cell for i, cell in enumerate(line) if len(line) == 1 or i not in timed)
        for line in lines
    )


def _close(one: str, other: str) -> bool:
    a, b = (float(text.replace(",", "")) for text in (one, other))
    decimals = one.partition(".")[2]
    place = 1.01 * 10.0 ** -len(decimals) if decimals.isdigit() else NOISE
    return abs(a - b) <= max(0.02 * max(abs(a), abs(b)), place)


def _shown(output: str, block: re.Match[str]) -> str:
    """Return what stands between the comments: the output, and the pictures as they are."""
    text = f"```text\n{output}\n```\n" if output else ""
    pictures = TEXT.sub("", block["output"]).strip("\n")
    return text + ("\n" if text and pictures else "") + (f"{pictures}\n" if pictures else "")


def _before(block: re.Match[str]) -> str:
    found = TEXT.search(block["output"])
    return found[1].strip("\n") if found else ""


def _key(page: str) -> str:
    """Return by what one knows that a page has been run with this code."""
    digest = hashlib.sha256("".join(block[0] for block in blocks(page)).encode())
    for path in sorted([*ROOT.glob("src/splitband/**/*.py"), *ROOT.glob("examples/*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def run(path: Path, check: bool) -> Iterator[str]:
    """Run the blocks of a page; yield what differs, and write it unless `check`."""
    page = path.read_text(encoding="utf-8")
    done = DONE / f"{path.stem}.sha256"
    if done.is_file() and done.read_text(encoding="utf-8") == _key(page):
        return
    outputs = executed(path, page, fetch=not check)
    page = path.read_text(encoding="utf-8")  # its prose may have been edited meanwhile
    text, end, differs = "", 0, False
    for block, output in zip(blocks(page), outputs, strict=True):
        before, after = _before(block), block["output"]
        if not alike(before, output):
            differs, after = True, _shown(output, block)
            lines = before.splitlines(), output.splitlines()
            yield "\n".join([*difflib.unified_diff(*lines, n=0, lineterm="")][2:])
        text += page[end : block.start("output")] + after
        end = block.end("output")
    page = text + page[end:]
    if not check:
        path.write_text(page, encoding="utf-8")
    if not (check and differs):
        DONE.mkdir(parents=True, exist_ok=True)
        done.write_text(_key(page), encoding="utf-8")


def main() -> None:
    """Run the pages that are named, or all, and say what differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path, help="all, where none is named")
    parser.add_argument("--check", action="store_true", help="write nothing; fail if one differs")
    given = parser.parse_args()
    if absent := [path for path in given.pages if not path.is_file()]:
        parser.error(
            f"pages must be paths of files, such as docs/howto/validation.md, got {absent[0]}"
        )
    status = 0
    for path in given.pages or sorted(DOCS.rglob("*.md")):
        if "<!--=output-->" not in path.read_text(encoding="utf-8"):
            continue
        print(f"{path} ...", flush=True)
        try:
            changes = [*run(path, given.check)]
        except ValueError as error:
            changes, status = [str(error)], 1
        print(*changes, sep="\n", flush=True)
        status = status or (given.check and bool(changes))
    sys.exit(status)


if __name__ == "__main__":
    main()
