"""What a file is, by its name and its first bytes: what is no recording is refused before the rest of it comes."""

from __future__ import annotations

from rce.errors import InvalidRequest

HEAD = 512  # bytes that are looked at
ROSBAG = b"#ROSBAG V2.0\n"
MAGIC: dict[str, tuple[bytes, str]] = {
    ".bag": (ROSBAG, "a ROS 1 bag of format 2.0"),
    ".db3": (b"SQLite format 3\0", "a ROS 2 bag in SQLite"),
    ".mcap": (b"\x89MCAP0\r\n", "an MCAP file"),
    ".clf.gz": (b"\x1f\x8b", "a CARMEN log compressed with gzip"),
    ".log.gz": (b"\x1f\x8b", "a CARMEN log compressed with gzip"),
    ".zstd": (b"\x28\xb5\x2f\xfd", "a part of a ROS 2 bag compressed with zstd"),
}
TEXT = {".clf": "a CARMEN log", ".log": "a CARMEN log", ".yaml": "the metadata of a ROS 2 bag"}
SUFFIXES = (*MAGIC, *TEXT)


def suffix_of(name: str, field: str = "Upload-Metadata.filename") -> str:
    """The suffix by which a file can be a recording or part of one. InvalidRequest."""
    for suffix in SUFFIXES:
        if name.endswith(suffix):
            return suffix
    raise InvalidRequest(f"{name} is not a recording by its name: {', '.join(SUFFIXES)} are taken", field=field)


def check_head(name: str, head: bytes) -> None:
    """InvalidRequest if a file of this name cannot begin like this; `head` is its first HEAD bytes, or all of it."""
    suffix = suffix_of(name)
    if suffix in TEXT:
        if b"\0" in head or not head.isascii():
            raise InvalidRequest(f"{name} is not {TEXT[suffix]}: it is not text", field="body")
        return
    magic, what = MAGIC[suffix]
    if head.startswith(magic):
        return
    if suffix == ".bag" and head.startswith((b"#ROSRECORD V", b"#ROSBAG V")):
        version = head.partition(b"\n")[0].partition(b"V")[2].strip().decode("ascii", "replace")
        raise InvalidRequest(
            f"{name} is a ROS bag of format {version[:10]}, and only 2.0 is read: convert it with `rosbag fix`",
            field="body",
        )
    raise InvalidRequest(f"{name} is not {what}: it begins with {head[:16]!r}", field="body")
