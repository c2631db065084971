"""Links of the pages to folders and files of the repository that are no pages.

A viewer of the repository follows them. The site has the files beside results (JSON, pictures) as
downloads, and shows where the others are.
"""

from __future__ import annotations

from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

NO_DOWNLOAD = (".md", ".py", "")
"""Files of these endings, and folders, are named but not copied to the site."""


class Elsewhere(SphinxTransform):
    """Replaces a link that leads out of the site by its text."""

    default_priority = 150

    def apply(self, **_: object) -> None:
        """Look at every link of a page that MyST has not resolved."""
        links = [*self.document.findall(addnodes.pending_xref)]
        links += [*self.document.findall(addnodes.download_reference)]
        for link in links:
            path = self._file(link)
            if path is None or not path.exists() or path.suffix not in NO_DOWNLOAD:
                continue
            if self.env.path2doc(path) not in self.env.found_docs:
                link.replace_self(nodes.inline("", "", *link.children, classes=["repository"]))

    def _file(self, link: nodes.Element) -> Path | None:
        """The file or folder that a link leads to; None for a link by another kind of name."""
        target = str(link.get("reftarget", "")).partition("#")[0]
        if not target:
            return None
        if link.get("refdomain") == "doc":  # by the name of the page, which need not be one
            return Path(self.env.srcdir, f"{target}.md").resolve()
        return (Path(self.env.doc2path(self.env.docname)).parent / target).resolve()


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the transform to Sphinx."""
    app.add_transform(Elsewhere)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
