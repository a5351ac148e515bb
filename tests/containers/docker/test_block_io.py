"""Devices of the limits of reads and writes."""

from __future__ import annotations

from containers.docker.block_io import Machine, block_io_limits
from containers.docker.disks import Disk
from rce.protocol.messages import Rates


def test_reads_are_limited_on_disk_and_images_and_writes_on_the_disk() -> None:
    limits = block_io_limits(Rates(read=5, write=6), Disk("/dev/loop0", 9), Machine("/dev/sda"))
    assert limits == {
        "device_read_bps": [{"Path": "/dev/loop0", "Rate": 5}, {"Path": "/dev/sda", "Rate": 5}],
        "device_write_bps": [{"Path": "/dev/loop0", "Rate": 6}],
    }


def test_unknown_device_and_missing_disk_are_left_out() -> None:
    assert block_io_limits(Rates(read=5, write=6), None, Machine()) == {"device_read_bps": [], "device_write_bps": []}
