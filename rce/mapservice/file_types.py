"""File types of recordings, recognized by name and first bytes, so that other files are refused early in an upload."""

from __future__ import annotations

from rce.errors import InvalidRequest

HEAD_SIZE = 512  # bytes that are checked
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
    """Return the suffix of a file that is a recording or a part of one.

    Raises:
        InvalidRequest: The file has another suffix; the error names `field`.
    """
    for suffix in SUFFIXES:
        if name.endswith(suffix):
            return suffix
    raise InvalidRequest(f"{name} is not a recording by its name: it must end in {', '.join(SUFFIXES)}", field=field)


def check_head(name: str, head: bytes) -> None:
    """Check the beginning of a file; `head` is its first HEAD_SIZE bytes, or all of a shorter file.

    Raises:
        InvalidRequest: No file of this type begins like this.
    """
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
        if version != "2.0":  # else its first line is damaged
            raise InvalidRequest(
                f"{name} is a ROS bag of format {version[:10]}, but only 2.0 is supported: convert it with "
                "`rosbag fix`",
                field="body",
            )
    raise InvalidRequest(f"{name} is not {what}: it begins with {head[:16]!r}", field="body")
