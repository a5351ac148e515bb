"""Translation keeps every field between messages, records and the arguments of calls."""

from __future__ import annotations

import msgspec

from master.graph.translation import container_data, interface_from, interface_spec, options_from
from rce.protocol import messages as m

DATA = m.ContainerData(
    image="rce/base",
    size=2,
    cpu=1.5,
    memory=3,
    pids=4,
    disk=5,
    bandwidth=6,
    io=m.Rates(7, 8),
    gpus=9,
    specialFeatures=["camera"],
    env={"A": "1"},
    secrets={"database": "B"},
    packages=["own"],
    group="g",
    groupIP="192.168.1.7",
    restart="no",
)


def test_container_data_comes_back_from_options() -> None:
    assert container_data(options_from(DATA)) == DATA
    given = {
        name for name in m.ContainerData.__struct_fields__ if getattr(DATA, name) == getattr(m.ContainerData(), name)
    }
    assert given == {"groupIp"}, "this test must give every option, and the original's other spelling is translated"


def test_other_spelling_of_the_group_address_is_taken() -> None:
    assert options_from(m.ContainerData(group="g", groupIp="192.168.1.9")).group_address == "192.168.1.9"


def test_interface_of_a_robot_keeps_its_delivery() -> None:
    delivery = m.Delivery("high", 0.5, 10.0, ("data",), m.Decimation(2, (320, 240)))
    command = m.AddInterface("r1", "in", "PublisherConverter", "std_msgs/String", delivery=delivery)
    spec = interface_spec(interface_from("1" * 32, "ann/r1", "PublisherConverter", command))
    assert spec.delivery == delivery


def test_interface_keeps_its_quality_of_service() -> None:
    qos = m.Qos("best_effort", "transient_local", "keep_all", 7)
    command = m.AddInterface("brain", "in", "PublisherInterface", "std_msgs/String", "chat", qos, "jpeg")
    spec = interface_spec(interface_from("1" * 32, "ann/brain", "PublisherInterface", command))
    assert (spec.tag, spec.addr, spec.qos, spec.format) == ("in", "chat", qos, "jpeg")
    assert msgspec.to_builtins(spec.qos) == msgspec.to_builtins(qos)
