"""The archive format: one archive for each content, and rejection of everything else."""

from __future__ import annotations

import hashlib
import io
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rce.errors import InvalidRequest, LimitExceeded
from rce.packages import archive
from rce.packages.archive import Entry

FILES = {"p/package.xml": b"<package/>", "p/scripts/talk": b"x" * 700, "p/empty": b""}


def packed(tmp_path: Path, files: dict[str, bytes] = FILES) -> bytes:
    entries = []
    for number, (name, content) in enumerate(files.items()):
        source = tmp_path / f"source{number}"
        source.write_bytes(content)
        entries.append(Entry(name, source, executable=name.endswith("talk")))
    out = io.BytesIO()
    archive.write(entries, out)
    return out.getvalue()


def tar(*members: tuple[str, bytes] | tarfile.TarInfo) -> bytes:
    """Return a tar file of files with canonical headers, or with headers as given."""
    out = io.BytesIO()
    for member in members:
        header, content = (member, b"") if isinstance(member, tarfile.TarInfo) else (info(member[0]), member[1])
        header.size = len(content) or header.size
        out.write(header.tobuf(tarfile.USTAR_FORMAT) + content + bytes(-len(content) % 512))
    return out.getvalue() + bytes(1024)


def info(name: str, **fields: object) -> tarfile.TarInfo:
    header = tarfile.TarInfo(name)
    for field, value in {"mode": 0o644, **fields}.items():
        setattr(header, field, value)
    return header


def test_pack_and_unpack(tmp_path: Path) -> None:
    data = packed(tmp_path)
    contents = archive.unpack(io.BytesIO(data), tmp_path / "out")
    assert contents == archive.Contents(hashlib.sha256(data).hexdigest(), len(data), 3, ["p"], installed=False)
    assert {name: (tmp_path / "out" / name).read_bytes() for name in FILES} == FILES
    modes = {name: (tmp_path / "out" / name).stat().st_mode & 0o777 for name in ("p", *FILES)}
    assert modes == {"p": 0o555, "p/package.xml": 0o444, "p/scripts/talk": 0o555, "p/empty": 0o444}
    with tarfile.open(fileobj=io.BytesIO(data)) as ordinary:  # other programs can read it
        assert sorted(ordinary.getnames()) == sorted(FILES)


def test_same_content_gives_the_same_archive(tmp_path: Path) -> None:
    assert packed(tmp_path, FILES) == packed(tmp_path, dict(reversed(FILES.items())))


def test_install_prefix_is_recognized(tmp_path: Path) -> None:
    data = packed(tmp_path, {"share/p/package.xml": b"", "share/q/package.xml": b"", "lib/p/talk": b""})
    contents = archive.inspect(io.BytesIO(data))
    assert (contents.packages, contents.installed) == (["p", "q"], True)


PACKAGE = ("p/package.xml", b"<package/>")
HOSTILE: dict[str, Callable[[], bytes]] = {
    "absolute": lambda: tar(("/etc/passwd", b"x"), PACKAGE),
    "parent directory": lambda: tar(("../x", b"x"), PACKAGE),
    "parent directory within": lambda: tar(PACKAGE, ("p/x/../../../y", b"x")),
    "dot": lambda: tar(PACKAGE, ("p/./x", b"x")),
    "empty part": lambda: tar(PACKAGE, ("p//x", b"x")),
    "backslash": lambda: tar(PACKAGE, ("p/..\\x", b"x")),
    "line break": lambda: tar(PACKAGE, ("p/x\ny", b"x")),
    "symbolic link": lambda: tar(PACKAGE, info("p/x", type=tarfile.SYMTYPE, linkname="/etc/passwd")),
    "hard link": lambda: tar(PACKAGE, info("p/x", type=tarfile.LNKTYPE, linkname="p/package.xml")),
    "device": lambda: tar(PACKAGE, info("p/x", type=tarfile.CHRTYPE, devmajor=1)),
    "pipe": lambda: tar(PACKAGE, info("p/x", type=tarfile.FIFOTYPE)),
    "directory": lambda: tar(info("p", type=tarfile.DIRTYPE), PACKAGE),
    "extended header": lambda: tar(info("p/pax", type=tarfile.XHDTYPE), PACKAGE),
    "GNU long name": lambda: tar(info("././@LongLink", type=tarfile.GNUTYPE_LONGNAME), PACKAGE),
    "setuid": lambda: tar(PACKAGE, info("p/x", mode=0o4755)),
    "owner": lambda: tar(PACKAGE, info("p/x", uid=7)),
    "time": lambda: tar(PACKAGE, info("p/x", mtime=1)),
    "duplicate": lambda: tar(PACKAGE, PACKAGE),
    "out of order": lambda: tar(PACKAGE, ("o", b"")),
    "parent is a file": lambda: tar(PACKAGE, ("p/x", b""), ("p/x/y", b"")),
    "no package": lambda: tar(("p/x", b"")),
    "empty": lambda: tar(),
    "truncated": lambda: tar(PACKAGE)[:700],
    "no end marker": lambda: tar(PACKAGE)[:1024],
    "data after the end": lambda: tar(PACKAGE) + b"x",
    "size beyond the end": lambda: tar(info("p/package.xml", size=10**9)),
    "garbage": lambda: b"garbage" * 200,
    "nothing": lambda: b"",
    "gzip": lambda: b"\x1f\x8b" + bytes(1000),
}


@pytest.mark.parametrize("make", HOSTILE.values(), ids=HOSTILE.keys())
def test_invalid_archive_is_rejected(make: Callable[[], bytes], tmp_path: Path) -> None:
    for read in (archive.inspect, lambda file: archive.unpack(file, tmp_path / "out")):
        with pytest.raises(InvalidRequest):
            read(io.BytesIO(make()))
    assert not (tmp_path / "out").exists()


def test_number_of_files_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = packed(tmp_path)
    monkeypatch.setattr(archive, "MAX_FILES", 2)
    with pytest.raises(LimitExceeded):
        archive.inspect(io.BytesIO(data))


@pytest.mark.parametrize("name", ["p/" + "x" * 101, "p/ä", "/p", "p/../../x"])
def test_path_that_cannot_be_packed_is_rejected(tmp_path: Path, name: str) -> None:
    with pytest.raises(InvalidRequest):
        packed(tmp_path, {name: b""})
