"""Tests of the ROS 2 node `worker`."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.scan_arrays import pack_scans
from rce.mapping.parallel.states import PartMap
from rce.mapping.parallel.units import (
    Answer,
    Busy,
    Failed,
    FindOverlaps,
    MapPart,
    Mapped,
    Unit,
    Work,
    decode_answer,
    encode,
)
from tests.support.spin import spin_until

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import UInt8MultiArray


class Job:
    """Sends units to a worker and collects its answers."""

    def __init__(self) -> None:
        from rce_mapping.worker import KEPT, WorkerNode

        self.answers: list[Answer] = []
        self._worker, self._node = WorkerNode(), rclpy.create_node("job")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._worker)
        self._executor.add_node(self._node)
        self._units = self._node.create_publisher(UInt8MultiArray, "units", KEPT)
        self._node.create_subscription(UInt8MultiArray, "answers", self._on_answer, KEPT)

    def _on_answer(self, message: Any) -> None:
        self.answers.append(decode_answer(bytes(message.data)))

    def until(self, condition: Callable[[], object]) -> None:
        spin_until(self._executor, condition)

    def send(self, data: bytes) -> None:
        self._units.publish(UInt8MultiArray(data=array("B", data)))

    def result(self, number: int, work: Work) -> Mapped | Failed:
        self.send(encode(Unit(number, work)))
        self.until(lambda: self.results(number))
        return self.results(number)[0]

    def results(self, number: int) -> list[Mapped | Failed]:
        return [each.result for each in self.answers if each.number == number and not isinstance(each.result, Busy)]

    def close(self) -> None:
        self._executor.shutdown()
        self._worker.destroy_node()
        self._node.destroy_node()


@pytest.fixture
def job(start_ros: Callable[..., None]) -> Iterator[Job]:
    start_ros()
    job = Job()
    yield job
    job.close()


def test_worker_answers_units_and_shows_that_it_lives(job: Job, simulation: Simulation) -> None:
    job.until(lambda: job.answers)
    assert job.answers[0] == Answer(-1, Busy(0)), "it says that it is ready"
    result = job.result(5, MapPart(0, pack_scans(simulation.records[:20]), MapperSettings()))
    assert isinstance(result, Mapped)
    assert len(PartMap.unpack(result.state).history) == 20
    job.until(lambda: Answer(5, Busy(20)) in job.answers)


def test_repeated_unit_is_answered_again_but_not_done_again(job: Job) -> None:
    first = job.result(1, FindOverlaps(0, 1))
    assert isinstance(first, Failed)
    job.send(encode(Unit(1, FindOverlaps(0, 1))))
    job.until(lambda: len(job.results(1)) == 2)
    assert job.results(1)[1] == first
    job.send(b"not a unit")
    assert isinstance(job.result(2, FindOverlaps(3, 4)), Failed), "it goes on after other bytes"
