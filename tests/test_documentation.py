"""The documentation: it reads where it lies, its site leaves nothing out, and its examples run.

What takes long, running the blocks of the pages, is left to `make docs`.
"""

from __future__ import annotations

import doctest
import io
import re
import warnings
from contextlib import redirect_stderr, redirect_stdout
from html.parser import HTMLParser
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import splitband
from docs.run import PICTURE, alike, blocks, run
from docs.tables import PAGES
from splitband.cli import COMMANDS
from splitband.comparison.methods import NAMES
from splitband.export.writing import FORMATS

DOCS = Path(__file__).resolve().parents[1] / "docs"
EXAMPLES = [
    *("ComplementaryPair", "Ensemble", "Filtered", "Residual", "Single", "Split", "Record"),
    *("compare", "inspect", "load", "networks.rollout", "read", "rmse"),
]
"""Public names whose docstrings must have an example."""


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_of_a_docstring_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    described = attrgetter(name)(splitband)
    names = {"sb": splitband, "np": np}
    (found,) = (
        test
        for test in doctest.DocTestFinder(recurse=False).find(described, name, globs=names)
        if test.examples
    )
    with redirect_stdout(io.StringIO()) as said:
        failed, tried = doctest.DocTestRunner().run(found)
    assert tried
    assert not failed, said.getvalue()


def test_parts_of_ones_own_are_one_class_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The example of CONTRIBUTING runs, and what it shows is there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("splitband.export.writing.FORMATS", {**FORMATS})
    text = (DOCS.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names: dict[str, Any] = {"__name__": __name__}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", splitband.ExtrapolationWarning)
        exec(compile(code, "CONTRIBUTING.md", "exec"), names)
    assert {*names["result"].table.index} == {"leaky", "slope", "residual-leaky"}
    assert (tmp_path / "slope.c").is_file()
    assert (tmp_path / "slope.txt").read_text(encoding="utf-8").startswith("slope")
    model = names["model"]
    np.testing.assert_allclose(model.stream().step(), model.predict(1).y[0])


class Loaded(HTMLParser):
    """What a page makes a browser load."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep what is loaded by itself; a link is followed by its reader alone."""
        names = {"script": "src", "img": "src", "link": "href", "iframe": "src"}
        self.addresses += [value or "" for name, value in attrs if name == names.get(tag)]


def _built(pages: Path, out: Path, *options: str) -> tuple[int, str]:
    """Build pages with warnings as errors; return the status and what was said of errors."""
    for package in ("sphinx", "furo", "numpydoc", "myst_parser", "latex2mathml"):
        pytest.importorskip(package, reason="pip install 'splitband[docs]'")
    build = import_module("sphinx.cmd.build")
    words = ["-q", "-W", "--keep-going", *options, str(pages), str(out)]
    said = io.StringIO()
    with (
        warnings.catch_warnings(),
        pytest.MonkeyPatch.context() as patch,
        redirect_stderr(said),
        redirect_stdout(io.StringIO()),
    ):
        warnings.simplefilter("ignore")  # of the packages among themselves
        patch.setattr("tempfile.tempdir", str(out.parent))  # where the log of an error is left
        status: int = build.main(words)
    return status, said.getvalue()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    assert _built(DOCS, out, "-d", str(out / ".doctrees")) == (0, "")
    return out


def test_every_public_name_and_every_command_is_in_the_reference(site: Path) -> None:
    pages = [path.read_text(encoding="utf-8") for path in (site / "reference").glob("*.html")]
    described = {name for page in pages for name in re.findall(r'id="splitband\.(\w+)"', page)}
    assert described == {*splitband.__all__} - {"networks"}
    commands = (site / "reference/commands.html").read_text(encoding="utf-8")
    sections = re.findall(r'<section id="splitband-(\w+)">', commands)
    assert [name for name in sections if name in COMMANDS] == [*COMMANDS]


def test_every_method_is_in_the_guide_to_the_table() -> None:
    """By its name, or by what it begins or ends with."""
    guide = (DOCS / "howto" / "table.md").read_text(encoding="utf-8")
    listed = guide.partition("## The methods")[2].partition("`--methods")[0]
    terms = re.findall(r"`([^`]+)`", listed)
    names = {term for term in terms if term[0] not in "-."}
    begins = tuple(name.removesuffix("...") for name in names if name.endswith("..."))
    ends = tuple(term.removeprefix("...") for term in terms if term not in names)
    for method in NAMES:
        usual = method
        while usual not in names and usual.endswith(ends):
            usual = usual.rpartition("-")[0]
        assert usual in names or method.startswith(begins), method


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    for path in site.rglob("*.html"):
        page = Loaded()
        page.feed(path.read_text(encoding="utf-8"))
        assert page.addresses
        assert not [a for a in page.addresses if re.match(r"\w+:|//", a) and "data:" not in a]


def test_links_lead_to_files_and_headings_in_a_viewer_of_the_repository_too() -> None:
    pages = [path for path in DOCS.rglob("*.md") if "_build" not in path.parts]
    names = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "reproduction/REPORT.md")
    broken = [
        (path.name, link)
        for path in (*pages, *(DOCS.parent / name for name in names))
        for link in re.findall(r"\]\(([^)`\s]+)\)", path.read_text(encoding="utf-8"))
        if not re.match(r"\w+:", link) and not _leads(path, link)
    ]
    assert broken == []


def _leads(page: Path, link: str) -> bool:
    """Return whether a relative link leads to a file, and to the heading that it names."""
    name, _, anchor = link.partition("#")
    path = page.parent / name if name else page
    if not path.exists() or not anchor:
        return path.exists()
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return anchor in {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in headings}


def test_pages_show_what_they_include_and_what_their_blocks_give() -> None:
    for path in PAGES:
        text = path.read_text(encoding="utf-8")
        assert not re.findall(r"^[`:]{3,}\{(?:run|include|literalinclude)\}.*", text, re.M), path
        for block in blocks(text):
            given = block["output"]
            assert "```text" in given or "print(" not in block["code"], (path, block["code"])
            drawn = re.findall(r"""savefig\("([^"]+)""", block["code"])
            assert drawn == [Path(link).name for link in PICTURE.findall(given)], path
            assert all((path.parent / link).is_file() for link in PICTURE.findall(given)), path


def test_blocks_are_run_again_and_what_differs_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("docs.run.DONE", tmp_path / "done")
    page = tmp_path / "page.md"
    text = "```python\na = 7\nprint(a)\n```\n<!--=output-->\n```text\n{}\n```\n<!--/-->\n"
    shell = "\n```bash\necho dot > dot.png; echo 2.00 m, 3 s\n```\n<!--=output-->\n{}<!--/-->\n"
    picture = "![A dot](img/dot.png)\n"
    page.write_text(text.format(8) + shell.format(picture))
    assert len([*run(page, check=True)]) == 2
    assert not (tmp_path / "img").exists()
    assert len([*run(page, check=False)]) == 2
    whole = text.format(7) + shell.format(f"```text\n2.00 m, 3 s\n```\n\n{picture}")
    assert page.read_text() == whole
    assert (tmp_path / "img/dot.png").read_text() == "dot\n"
    for close in (whole.replace("2.00", "2.01").replace("3 s", "9 s"), f"More.\n\n{whole}"):
        page.write_text(close)
        assert [*run(page, check=True)] == []
    page.write_text(whole.replace("print(a)", "print(1 / 0)"))
    with pytest.raises(ValueError, match="ZeroDivisionError"):
        [*run(page, check=True)]


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("fit 97.0 %", "fit 95.5 %", True),
        ("fit 97.0 %", "fit 90.0 %", False),
        ("-0.1", "0.0", True),
        ("difference 3e-15", "difference 1e-16", True),
        ("took 3 s, ended 0:12", "took 40 ms, ended 2:00", True),
        ("2 poles", "two poles", False),
        ("┃ a ┃ fit (s) ┃\n│ 1 │ 0.3 │", "┃ a ┃  fit (s) ┃\n│ 1 │ 17.5 │", True),
        ("┃ a ┃ fit (s) ┃\n│ 1 │ 0.3 │", "┃ a ┃ fit (s) ┃\n│ 2 │ 0.3 │", False),
    ],
)
def test_outputs_are_alike_but_for_times_and_last_places(one: str, other: str, same: bool) -> None:
    assert alike(one, other) is same
