"""Parameters of running nodes, at a real endpoint, and their values as ROS messages."""

from __future__ import annotations

from typing import Any, cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rcl_interfaces.msg import ParameterType
from rclpy.parameter import parameter_value_to_python

from endpoints.environment.live_parameters import ros_value
from rce.control.calls.endpoints import NodeSpec, ParameterSpec, PutParameter, StartNode, StopNode
from rce.control.calls.watching import ReadLog
from rce.errors import InvalidRequest
from rce.protocol.messages import ParameterValue
from tests.support.endpoints.environment_driver import FakeMaster, wait_for_line

VALUES: list[tuple[ParameterValue, str]] = [
    (True, "BOOL"),
    (-5, "INTEGER"),
    (2.5, "DOUBLE"),
    ("1", "STRING"),
    ([True, False], "BOOL_ARRAY"),
    ([1, 2], "INTEGER_ARRAY"),
    ([1.0, 2.5], "DOUBLE_ARRAY"),
    (["a", ""], "STRING_ARRAY"),
]


def number(kind: str) -> int:
    found: int = getattr(ParameterType, f"PARAMETER_{kind}")
    return found


def plain(value: Any) -> Any:
    """Return a ROS value as Python has it, arrays as lists."""
    found = parameter_value_to_python(value)
    return found if isinstance(found, bool | int | float | str) else list(cast(Any, found))


@pytest.mark.parametrize(("value", "kind"), VALUES)
def test_value_has_its_type_in_ros(value: ParameterValue, kind: str) -> None:
    found = ros_value(value, number(kind))
    assert (found.type, plain(found)) == (number(kind), value)


@pytest.mark.parametrize(("value", "kind"), [(3, "DOUBLE"), ([1, 2], "DOUBLE_ARRAY")])
def test_integers_become_floats_where_node_declares_them(value: ParameterValue, kind: str) -> None:
    found = ros_value(value, number(kind))
    assert (found.type, plain(found)) == (number(kind), value)


def test_empty_list_has_the_array_type_that_node_declares() -> None:
    assert plain(ros_value([], number("INTEGER_ARRAY"))) == []
    assert plain(ros_value([], number("STRING"))) == "[]"


def test_list_of_mixed_types_is_text() -> None:
    assert plain(ros_value(["one", 2], number("STRING"))) == '["one", 2]'
    assert ros_value(["one", 2], number("STRING_ARRAY")).type == number("STRING")  # which the node refuses


@pytest.mark.parametrize(("value", "declared", "kind"), [(2.5, "INTEGER", "DOUBLE"), (True, "DOUBLE", "BOOL")])
def test_other_values_keep_their_type_and_node_refuses_them(value: ParameterValue, declared: str, kind: str) -> None:
    assert ros_value(value, number(declared)).type == number(kind)


async def test_parameters_of_running_nodes(master: FakeMaster) -> None:
    await wait_for_line(master, "echo", "words is")
    await master.call(StartNode(NodeSpec("other", "probe", "echo", namespace="/other")))
    await wait_for_line(master, "other", "words is")
    await master.call(PutParameter(ParameterSpec("speed", 3, "other")))
    assert "becomes 3.0" in await wait_for_line(master, "other", "speed becomes")
    assert not [line for line in (await master.call(ReadLog("echo"))).lines if "speed becomes" in line]
    await master.call(PutParameter(ParameterSpec("words", ["a"])))
    for tag in ("echo", "other"):
        assert "['a']" in await wait_for_line(master, tag, "words becomes")
    await master.call(PutParameter(ParameterSpec("undeclared", 1)))
    with pytest.raises(InvalidRequest, match="too fast"):
        await master.call(PutParameter(ParameterSpec("speed", 11)))
    with pytest.raises(InvalidRequest, match="node /other/echo: it declares double, not string"):
        await master.call(PutParameter(ParameterSpec("speed", "fast")))
    await master.call(StopNode("other"))
