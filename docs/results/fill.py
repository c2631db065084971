"""Put the tables of tables/*.md into README.md, each between its two marks."""

import re
from pathlib import Path

HERE = Path(__file__).parent


def main() -> None:
    """Rewrite README.md."""
    page = (HERE / "README.md").read_text(encoding="utf-8")
    for path in sorted((HERE / "tables").glob("*.md")):
        begin, end = f"<!-- {path.stem} -->\n", f"<!-- end of {path.stem} -->"
        if begin not in page:
            raise SystemExit(f"README.md has no place for the table {path.stem}: {begin.strip()}")
        table = path.read_text(encoding="utf-8")
        inside = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        page = inside.sub(lambda _, text=begin + table + end: text, page)
    (HERE / "README.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
