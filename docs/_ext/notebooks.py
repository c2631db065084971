"""Notebooks of the pages whose blocks are executed, with what the blocks gave.

The prose between the blocks is that of the page. Links within the site become plain text, as a
notebook is read elsewhere.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

BLOCK = re.compile(r"^```\{run\}.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[([^\]]*)\]\((?!https?:)[^)]*\)")
COMMENT = re.compile(r"<!--.*?-->")
ROLE = re.compile(r"\{py:\w+\}`~?(?:[\w.]+\.)?(\w+)`")


def notebook(
    page: str, blocks: Sequence[Mapping[str, str]], results: Sequence[Mapping[str, str]], kept: Path
) -> str:
    """Return a notebook in nbformat 4.5 of a page in Markdown.

    `blocks` are those of the page in their order, `results` what each gave; figures lie in `kept`.
    """
    prose = BLOCK.split(page)
    cells = _markdown(prose[0])
    for block, result, text in zip(blocks, results, prose[1:], strict=True):
        cells += [*_code(block, result, kept), *_markdown(text)]
    for i, cell in enumerate(cells):
        cell["id"] = f"cell-{i}"
    language = {"name": "python", "display_name": "Python 3", "language": "python"}
    metadata = {"kernelspec": language, "language_info": {"name": "python"}}
    facts = {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(facts, indent=1, ensure_ascii=False) + "\n"


def _markdown(text: str) -> list[dict[str, Any]]:
    """Return a cell of prose, none where there is none."""
    plain = ROLE.sub(r"`\1`", LINK.sub(r"\1", COMMENT.sub("", text))).strip()
    return [{"cell_type": "markdown", "metadata": {}, "source": plain}] if plain else []


def _code(block: Mapping[str, str], result: Mapping[str, str], kept: Path) -> list[dict[str, Any]]:
    """Return the cell of a block with its outputs; a second one opens the picture it writes."""
    first = _cell("%%bash\n" * (block["kind"] == "console") + block["code"])
    if result["output"]:
        stream = {"output_type": "stream", "name": "stdout", "text": result["output"] + "\n"}
        first["outputs"].append(stream)
    if result["html"]:
        first["outputs"].append(_shown({"text/html": result["html"]}))
    if "figure" not in result:
        return [first]
    second = _cell(f'from IPython.display import Image\n\nImage("{block["figure"]}")')
    picture = base64.b64encode((kept / result["figure"]).read_bytes()).decode("ascii")
    second["outputs"].append(_shown({"image/png": picture}))
    return [first, second]


def _cell(code: str) -> dict[str, Any]:
    made: dict[str, Any] = {"cell_type": "code", "execution_count": None, "metadata": {}}
    return {**made, "outputs": [], "source": code}


def _shown(data: Mapping[str, str]) -> dict[str, Any]:
    return {"output_type": "display_data", "data": data, "metadata": {}}
