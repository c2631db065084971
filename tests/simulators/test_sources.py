"""What counts as a simulator's content: its file, what that imports, and what its user names."""

from pathlib import Path

import numpy as np
import pytest

from splitband.simulators import run
from splitband.simulators.isolation import Isolated

FILES = {
    "sim.py": "import json\nimport numpy as np\nfrom pack.sub import inner\nimport space.deep\n"
    "def f(time):\n    import late, other\n    return inner.factor() * time\n",
    "late.py": "",
    "unused.py": "",
    "pack/__init__.py": "",
    "pack/sub/__init__.py": "from . import beside\n",
    "pack/sub/beside.py": "import sim  # a circle\n",
    "pack/sub/inner.py": "from pathlib import Path\nfrom ..level import LEVEL\n"
    "def factor():\n    return LEVEL * float(Path(__file__).with_name('f.txt').read_text())\n",
    "pack/level.py": "LEVEL = 1.0\n",
    "pack/sub/f.txt": "2",
    "space/deep.py": "",
    "elsewhere/other.py": "",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path.resolve()


def test_what_is_kept_is_computed_again_when_a_module_or_a_named_file_changes(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(folder / "elsewhere")
    named = str(folder / "pack/sub/f.txt")
    simulator = Isolated(str(folder / "sim.py"), "f", reads=(named,))

    def last() -> float:
        return float(run(simulator, 3, 0.5, cache=folder / "cache")[-1, 0])

    assert last() == 2
    own = {name for name in FILES if name.endswith(".py")} - {"sim.py", "unused.py"}
    assert own <= {str(Path(file).relative_to(folder)) for file in simulator.files
                   if folder in Path(file).parents}  # fmt: skip
    (folder / "pack/level.py").write_text("LEVEL = 10.0\n")
    assert last() == 20
    Path(named).write_text("3")
    assert last() == 30
    (folder / "elsewhere/other.py").write_text("changed = True\n")
    assert last() == 30
    stored = max((folder / "cache").iterdir(), key=lambda path: path.stat().st_mtime)
    kept = dict(np.load(stored))
    np.savez(stored, **kept | {"y": kept["y"] + 1})
    (folder / "unused.py").write_text("changed = True\n")
    assert last() == 31  # as it was kept
    (folder / "late.py").write_text("changed = True\n")
    assert last() == 30
