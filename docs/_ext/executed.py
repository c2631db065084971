"""The directive `{run}`: a block of a page that is executed, with what it prints below it.

A page's blocks run in their order, in a process and a new folder of their own; blocks of Python
share their variables. What they give is kept by the content of the blocks and of the package, so
that a second build of the same runs nothing. A block that fails ends the build. A link below the
title downloads the page as a notebook.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from notebooks import notebook
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.transforms import SphinxTransform
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

LANGUAGES = {"python": "python", "console": "bash"}
"""What a block can be, and how it is highlighted."""
WIDTH = 88
"""Characters of a line that a page has room for."""
ROOT = Path(__file__).resolve().parents[2]
KEPT = "_build/executed"
"""Where results are kept, below the folder of the pages."""
WORKER = Path(__file__).with_name("worker.py")


class Block(nodes.General, nodes.Element):  # type: ignore[misc]  # docutils is not typed
    """A block that has not been executed yet."""


class Run(SphinxDirective):
    """Executes its content: `python`, or `console` for the commands of a shell, one a line."""

    required_arguments = 1
    has_content = True
    option_spec: ClassVar = {
        "figure": directives.unchanged_required,
        "alt": directives.unchanged_required,
        "quiet": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Leave a block to be executed once the page has been read."""
        kind = self.arguments[0]
        if kind not in LANGUAGES:
            raise self.error(f"a block must be one of {', '.join(LANGUAGES)}, got {kind}")
        if "figure" in self.options and "alt" not in self.options:
            raise self.error("a figure must have an alt text")
        code = "\n".join(self.content)
        block = Block(kind=kind, code=code, **self.options)
        self.set_source_info(block)
        return [block]


class Execute(SphinxTransform):
    """Replaces the blocks of a page by their code, what they print and the figures they write."""

    default_priority = 200

    def apply(self, **_: Any) -> None:
        """Execute them, or show them alone where `run_blocks` is off."""
        blocks = [*self.document.findall(Block)]
        if not blocks:
            return
        results: list[dict[str, str]] = [{} for _ in blocks]
        if self.config.run_blocks:
            kept = Path(self.env.srcdir) / KEPT
            asked = [
                {name: block.get(name, "") for name in ("kind", "code", "figure")}
                for block in blocks
            ]
            results = _results(self.env.docname, asked, kept)
            page = Path(self.env.doc2path(self.env.docname)).read_text(encoding="utf-8")
            name = f"{self.env.docname.replace('/', '-')}.ipynb"
            (kept / name).write_text(notebook(page, asked, results, kept), encoding="utf-8")
            self._link(f"/{KEPT}/{name}")
        for block, result in zip(blocks, results, strict=True):
            block.replace_self(_shown(block, result))

    def _link(self, path: str) -> None:
        """Put a link to the notebook of the page below its title."""
        title = next(iter(self.document.findall(nodes.title)))
        link = addnodes.download_reference("", "this page as a notebook", reftarget=path)
        place = title.parent.index(title) + 1
        title.parent.insert(place, nodes.paragraph("", "", nodes.Text("Download "), link))


def _shown(block: Block, result: dict[str, str]) -> list[nodes.Node]:
    """A block and what came of it, as nodes."""
    code = nodes.literal_block(block["code"], block["code"], language=LANGUAGES[block["kind"]])
    shown: list[nodes.Node] = [code]
    if result.get("output") and "quiet" not in block:
        text = "\n".join(_wrapped(line) for line in result["output"].splitlines())
        output = nodes.literal_block(text, text, language="text")
        output["classes"].append("output")
        shown.append(output)
    if result.get("html") and "quiet" not in block:
        shown.append(nodes.raw("", result["html"], format="html"))
    if "figure" in result:
        image = nodes.image(uri=f"/{KEPT}/{result['figure']}", alt=block["alt"])
        shown.append(nodes.figure("", image))
    return shown


def _wrapped(line: str) -> str:
    """A sentence on lines of a page's width; a row of a table as it is."""
    if len(line) <= WIDTH or line[0] in "│┃┏┡└":
        return line
    return textwrap.fill(line, WIDTH, subsequent_indent="  ", break_long_words=False)


def _results(page: str, asked: Sequence[dict[str, str]], kept: Path) -> list[dict[str, str]]:
    """What each block gave, from an earlier build where nothing has changed since."""
    key = _key(page, asked)
    stored = kept / f"{key}.json"
    if not stored.is_file():
        kept.mkdir(parents=True, exist_ok=True)
        logging.getLogger(__name__).info("executing the blocks of %s", page)
        results = _executed(page, asked, kept, key)
        stored.write_text(json.dumps(results), encoding="utf-8")
    found: list[dict[str, str]] = json.loads(stored.read_text(encoding="utf-8"))
    return found


def _key(page: str, asked: Sequence[dict[str, str]]) -> str:
    """By what results are kept."""
    digest = hashlib.sha256(json.dumps(asked).encode())
    for path in sorted([WORKER, *ROOT.glob("src/splitband/**/*.py"), *ROOT.glob("examples/*.py")]):
        digest.update(path.read_bytes())
    return f"{page.replace('/', '-')}-{digest.hexdigest()[:16]}"


def _executed(
    page: str, asked: Sequence[dict[str, str]], kept: Path, key: str
) -> list[dict[str, str]]:
    """Run the blocks in a folder of their own and fetch the figures from it."""
    paths = {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]),
        "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]),
    }
    shown = {"COLUMNS": "100", "MPLBACKEND": "agg", "NO_COLOR": "1"}
    with TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "examples", Path(folder, "examples"))
        how: dict[str, Any] = {"text": True, "capture_output": True, "cwd": folder}
        how |= {"input": json.dumps(asked), "env": {**os.environ, **paths, **shown}}
        done = subprocess.run([sys.executable, str(WORKER)], check=False, **how)
        if done.returncode:
            raise ExtensionError(f"{page}: a block failed:\n{done.stderr}\n{done.stdout}")
        results: list[dict[str, str]] = json.loads(done.stdout)
        for i, (block, result) in enumerate(zip(asked, results, strict=True)):
            if block["figure"]:
                written = Path(folder, block["figure"])
                if not written.is_file():
                    raise ExtensionError(f"{page}: no block has written {block['figure']}")
                result["figure"] = f"{key}-{i}{written.suffix}"
                shutil.copy(written, kept / result["figure"])
    return results


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive to Sphinx."""
    app.add_config_value("run_blocks", True, "env", types=[bool])
    app.add_node(Block)
    app.add_directive("run", Run)
    app.add_transform(Execute)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
