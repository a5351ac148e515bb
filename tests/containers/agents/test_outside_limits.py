"""Limits that are applied from outside; swarm/test_resources.py applies them to a real environment."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from containers.agents import outside_limits
from containers.agents.outside_limits import LimitRequest, apply
from containers.docker import disks, shaping
from containers.docker.disks import Disk
from rce.errors import StartFailed
from rce.protocol.messages import Rates

NULL = os.stat("/dev/null").st_rdev
NULL_NUMBER = f"{os.major(NULL)}:{os.minor(NULL)}"
READ, WRITE = Rates(read=5), Rates(read=5, write=6)


@pytest.fixture
def cgroups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Control groups of version 2, with that of this process; images are on the device /dev/null."""
    lines = Path("/proc/self/cgroup").read_text().splitlines()
    own = lines[0].split(":", 2)[2].lstrip("/")
    (tmp_path / own).mkdir(parents=True, exist_ok=True)
    (tmp_path / "cgroup.controllers").touch()
    monkeypatch.setattr(outside_limits, "CGROUPS", tmp_path)
    monkeypatch.setattr(disks, "underlying_disk", lambda path: "/dev/null")
    return tmp_path / own


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Recorder of the changes of disks and networks, which are stand-ins."""
    steps: list[str] = []

    def make(file: Path, size: int, owner: int) -> Disk:
        steps.append(f"make {file} of {size} for {owner}")
        return Disk("/dev/null", size)

    def shape(process: int, devices: list[str], rate: int) -> None:
        steps.append(f"shape {', '.join(devices)} to {rate}")

    def mount(process: int, device: str, *, synchronous: bool) -> None:
        steps.append(f"mount {device}{' synchronously' if synchronous else ''}")

    monkeypatch.setattr(disks, "check", lambda size: None)
    monkeypatch.setattr(disks, "make", make)
    monkeypatch.setattr(disks, "detach", lambda disk: steps.append(f"detach {disk.device}"))
    monkeypatch.setattr(shaping, "check", lambda: None)
    monkeypatch.setattr(shaping, "devices", lambda process: ["eth0", "eth1"])
    monkeypatch.setattr(shaping, "shape", shape)
    monkeypatch.setattr(outside_limits, "_mount_home", mount)
    return steps


def request(**limits: object) -> LimitRequest:
    return LimitRequest(os.getpid(), "/images", **limits)  # type: ignore[arg-type]


@pytest.mark.parametrize("limit", [{"bandwidth": 1}, {"disk": 1}, {"io": Rates(read=1)}, {"io": Rates(write=1)}])
def test_request_with_a_limit_is_not_empty(limit: dict[str, object]) -> None:
    assert request().is_empty
    assert not request(**limit).is_empty


def test_disk_is_mounted_and_left_to_its_mount(cgroups: Path, steps: list[str]) -> None:
    apply(request(disk=9, disk_file="/volume/disk", owner=10000))
    assert steps == ["make /volume/disk of 9 for 10000", "mount /dev/null", "detach /dev/null"]


def test_all_networks_are_shaped(cgroups: Path, steps: list[str]) -> None:
    apply(request(bandwidth=7))
    assert steps == ["shape eth0, eth1 to 7"]


def test_rates_are_limited_in_the_group_of_the_container(cgroups: Path, steps: list[str]) -> None:
    apply(request(io=READ))
    assert (cgroups / "io.max").read_text() == f"{NULL_NUMBER} rbps=5"


def test_writes_are_limited_on_the_disk(cgroups: Path, steps: list[str]) -> None:
    apply(request(disk=9, disk_file="/volume/disk", io=WRITE))
    assert (cgroups / "io.max").read_text() == f"{NULL_NUMBER} wbps=6"


def test_disk_is_synchronous_where_buffered_writes_are_not_limited(
    tmp_path: Path, cgroups: Path, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """That is so with control groups of version 1."""
    (tmp_path / "cgroup.controllers").unlink()
    monkeypatch.setattr(
        outside_limits, "_limit_rate", lambda process, kind, device, rate: steps.append(f"{kind} {rate}")
    )
    apply(request(disk=9, disk_file="/volume/disk", io=Rates(write=6)))
    assert steps[1:] == ["device_write_bps 6", "mount /dev/null synchronously", "detach /dev/null"]


def test_disk_is_detached_after_an_error(cgroups: Path, steps: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(process: int, device: str, *, synchronous: bool) -> None:
        raise StartFailed("cannot be mounted")

    monkeypatch.setattr(outside_limits, "_mount_home", refuse)
    with pytest.raises(StartFailed):
        apply(request(disk=9, disk_file="/volume/disk"))
    assert steps[-1] == "detach /dev/null"


def test_mount_in_the_namespace_of_an_ended_process_fails(capfd: pytest.CaptureFixture[str]) -> None:
    assert outside_limits._move_mount(0, f"/proc/{2**30}/ns/mnt") == 1
    assert "No such file" in capfd.readouterr().err
