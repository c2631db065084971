"""Libraries of FMUs: for which platforms, by which compiler, and what is said of it."""

import logging
import random
import re
import struct
import sys
import zipfile
from pathlib import Path

import fmpy
import pytest

import splitband as sb
from splitband.export.compiling import universal
from tests.streams import free

STAND_IN = """
import struct, sys
from pathlib import Path

words = sys.argv[1:]
target, out = words[words.index("-target") + 1], Path(words[words.index("-o") + 1])
with open(Path(__file__).with_name("calls.txt"), "a") as calls:
    print(*words, file=calls)
if Path(__file__).with_name("broken").exists() and "macos" in target:
    sys.exit("no such target")
assert words[0] == "cc" and all(Path(word).is_file() for word in words if word.endswith(".c"))
processors = {"x86_64-macos.11.0": (0x01000007, 3), "aarch64-macos.11.0": (0x0100000C, 0)}
head = struct.pack("<3I", 0xFEEDFACF, *processors[target]) if target in processors else b""
out.write_bytes(head + target.encode())
"""


@pytest.fixture
def zig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package in the place of ziglang, which writes down what it is asked to do."""
    site = tmp_path / "site"
    for folder in ("ziglang", "ziglang-0.13.0.dist-info"):
        (site / folder).mkdir(parents=True)
    (site / "ziglang/__init__.py").touch()
    (site / "ziglang/__main__.py").write_text(STAND_IN)
    facts = "Metadata-Version: 2.1\nName: ziglang\nVersion: 0.13.0\n"
    (site / "ziglang-0.13.0.dist-info/METADATA").write_text(facts)
    monkeypatch.delitem(sys.modules, "ziglang")
    monkeypatch.syspath_prepend(site)
    monkeypatch.setenv("PYTHONPATH", str(site))
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(tmp_path / "cache"))
    return site / "ziglang"


def exported(folder: Path) -> Path:
    (file,) = sb.Mean().fit(free()).export(folder / "rig.fmu")
    return file


def about_fmus(caplog: pytest.LogCaptureFixture) -> list[logging.LogRecord]:
    """What was said of FMUs; kernels may announce their compilation, too."""
    return [each for each in caplog.records if re.search("FMU|ziglang", each.getMessage())]


def test_with_ziglang_an_fmu_runs_on_all_platforms(
    zig: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "splitband")
    file = exported(tmp_path)
    with zipfile.ZipFile(file) as archive:
        held = {n: archive.read(n) for n in archive.namelist() if n.startswith("binaries/")}
    libraries = "win64/rig.dll", "linux64/rig.so", "darwin64/rig.dylib"
    assert {*held} == {f"binaries/{library}" for library in libraries}
    assert held["binaries/win64/rig.dll"] == b"x86_64-windows-gnu"
    assert b"aarch64-macos" in held["binaries/darwin64/rig.dylib"]
    platforms = {"c-code", "darwin64", "linux64", "win64"}
    assert {*fmpy.supported_platforms(str(file))} == platforms
    assert "Windows, Linux, macOS" in caplog.text
    calls = (zig / "calls.txt").read_text().splitlines()
    assert len(calls) == 4
    assert all("-ffp-contract=off" in call for call in calls)


def test_only_the_first_export_builds_c_libraries(
    zig: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first = exported(tmp_path).read_bytes()
    assert [each.levelname for each in about_fmus(caplog)] == ["WARNING"]
    assert "once after installation" in caplog.text
    caplog.clear()
    assert exported(tmp_path).read_bytes() == first
    assert not about_fmus(caplog)


def test_an_export_that_ziglang_cannot_make_names_the_platform(zig: Path, tmp_path: Path) -> None:
    (zig / "broken").touch()
    with pytest.raises(ValueError, match=r"by ziglang for x86_64-macos\.11\.0: no such target"):
        exported(tmp_path)
    assert not (tmp_path / "rig.fmu").exists()


def test_without_ziglang_an_fmu_runs_here_and_says_how_elsewhere(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = exported(tmp_path)
    assert {*fmpy.supported_platforms(str(file))} == {"c-code", fmpy.platform}
    assert [each.levelname for each in about_fmus(caplog)] == ["WARNING"]  # which Python shows
    assert 'pip install "splitband[everywhere]"' in caplog.text


def test_a_compiler_with_other_options_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "cl.exe"
    other.touch(mode=0o755)
    for given in (str(other), "cl /O2"):
        monkeypatch.setenv("CC", given)
        with pytest.raises(ValueError, match=r"CC must take the options of gcc.*everywhere"):
            exported(tmp_path)


def test_a_universal_file_is_as_its_format_says() -> None:
    """The structures `fat_header` and `fat_arch` of mach-o/fat.h, in big-endian words."""
    rng = random.Random(0)
    kinds = [(0x01000007, 3), (0x0100000C, 0)]  # CPU_TYPE_X86_64 and its ALL, CPU_TYPE_ARM64
    parts = [
        struct.pack("<8I", 0xFEEDFACF, *kind, 6, 0, 0, 0, 0) + rng.randbytes(size)
        for kind, size in zip(kinds, (70_001, 16_384 - 32), strict=True)
    ]
    file = universal(parts)
    magic, count = struct.unpack_from(">2I", file)
    assert (magic, count) == (0xCAFEBABE, 2)
    end = 8 + 20 * count
    for i, part in enumerate(parts):
        *kind, offset, size, align = struct.unpack_from(">5I", file, 8 + 20 * i)
        assert tuple(kind) == kinds[i]
        assert align == 14
        assert offset % 2**align == 0
        assert offset >= end  # no part lies in another one, or in the head
        assert file[offset : offset + size] == part
        end = offset + size
    assert end == len(file)
