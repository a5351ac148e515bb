"""File types of recordings, by name and first bytes."""

from __future__ import annotations

import pytest

from rce.errors import InvalidRequest
from rce.mapservice.file_types import HEAD_SIZE, SUFFIXES, check_head, suffix_of

HEADS = {
    "a.bag": b"#ROSBAG V2.0\n",
    "a.db3": b"SQLite format 3\0",
    "a.mcap": b"\x89MCAP0\r\n",
    "a.clf.gz": b"\x1f\x8b",
    "a.log.gz": b"\x1f\x8b",
    "a.db3.zstd": b"\x28\xb5\x2f\xfd",
    "a.clf": b"# comment\nFLASER 3",
    "a.log": b"",
    "metadata.yaml": b"rosbag2_bagfile_information:",
}


@pytest.mark.parametrize(("name", "head"), HEADS.items(), ids=HEADS)
def test_file_of_each_type_is_accepted(name: str, head: bytes) -> None:
    check_head(name, head)
    check_head(name, head.ljust(HEAD_SIZE, b"x"))


def test_samples_have_all_types() -> None:
    assert {suffix_of(name) for name in HEADS} == set(SUFFIXES)


@pytest.mark.parametrize("name", [name for name in HEADS if suffix_of(name) not in (".clf", ".log", ".yaml")])
def test_truncated_or_other_magic_is_refused(name: str) -> None:
    for head in (b"", HEADS[name][:-1], b"PK\x03\x04"):
        with pytest.raises(InvalidRequest, match="it begins with") as wrong:
            check_head(name, head)
        assert wrong.value.field == "body"


@pytest.mark.parametrize("name", ["a.clf", "a.log", "metadata.yaml"])
@pytest.mark.parametrize("head", [b"FLASER\0", "Straße".encode("latin-1"), HEADS["a.clf.gz"]], ids=ascii)
def test_text_with_other_bytes_than_ascii_is_refused(name: str, head: bytes) -> None:
    with pytest.raises(InvalidRequest, match="not text"):
        check_head(name, head)


@pytest.mark.parametrize(("head", "version"), [(b"#ROSRECORD V1.1\n", "1.1"), (b"#ROSBAG V1.2\nmore", "1.2")])
def test_old_bag_is_refused_with_the_remedy(head: bytes, version: str) -> None:
    with pytest.raises(InvalidRequest, match=rf"format {version}.*rosbag fix"):
        check_head("a.bag", head)


def test_version_of_a_bag_is_quoted_in_part() -> None:
    with pytest.raises(InvalidRequest) as wrong:
        check_head("a.bag", b"#ROSBAG V" + b"\xff" * 500)
    assert len(str(wrong.value)) < 200


@pytest.mark.parametrize("name", ["a.csv", "bag", "a.bag.zip", "a.BAG", ""])
def test_other_suffix_is_refused(name: str) -> None:
    with pytest.raises(InvalidRequest, match="not a recording by its name") as wrong:
        suffix_of(name, "recording.name")
    assert wrong.value.field == "recording.name"
