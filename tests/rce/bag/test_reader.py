"""Reader of recordings: of such that were cut off, and of other files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from rce.bag.reader import read, summarize
from rce.bag.writer import BagWriter, Topic
from rce.errors import InvalidRequest

STRING = Topic("/say", "std_msgs/msg/String", "string data\n")
PROGRAM = """
import sys, time
from pathlib import Path
from rce.bag.writer import BagWriter, Topic
recording = BagWriter(Path(sys.argv[1]))
for number in range(1000):
    recording.put(Topic("/say", "std_msgs/msg/String", "string data"), number.to_bytes(4), number)
time.sleep(1.5)
recording.put(Topic("/say", "std_msgs/msg/String", "string data"), b"last", 1000)
while recording.messages < 1001:
    time.sleep(0.01)
print("up", flush=True)
time.sleep(100)
"""


def recorded(path: Path, count: int = 10) -> Path:
    recording = BagWriter(path)
    for number in range(count):
        recording.put(STRING, bytes(100), number)
    recording.close({})
    return path


def test_recording_of_a_killed_process_is_read_up_to_its_last_second(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with subprocess.Popen([sys.executable, "-c", PROGRAM, path], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
        process.kill()
    summary = summarize(path)
    assert not summary.complete
    assert summary.counts["/say"] >= 1000
    assert [each.cdr for each in read(path)][:1000] == [number.to_bytes(4) for number in range(1000)]


@pytest.mark.parametrize("left", [1, 5, 100, 300])
def test_recording_that_was_cut_off_anywhere_is_read(tmp_path: Path, left: int) -> None:
    whole = recorded(tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(whole[:-left])
    summary = summarize(tmp_path / "b.mcap")
    assert not summary.complete
    assert set(summary.counts.values()) <= {10}


@pytest.mark.parametrize(
    ("content", "reason"), [(b"", "no MCAP"), (b"#ROSBAG V2.0\n", "no MCAP"), (None, "No such file")]
)
def test_other_file_is_refused(tmp_path: Path, content: bytes | None, reason: str) -> None:
    if content is not None:
        (tmp_path / "a").write_bytes(content)
    with pytest.raises(InvalidRequest, match=reason):
        summarize(tmp_path / "a")
