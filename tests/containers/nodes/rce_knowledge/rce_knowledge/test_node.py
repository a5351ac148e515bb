"""The node as a whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.support.environment_knowledge import direct_knowledge
from tests.support.knowledge import CUP
from tests.support.spin import spin_until


def test_services_have_the_names_of_roboearth(interfaces: None) -> None:
    from rce_knowledge.node import service_name

    assert service_name("GetActionRecipe") == "/re_comm/get_action_recipe"
    assert service_name("SetObjectBinaryFile") == "/re_comm/set_object_binary_file"
    assert service_name("Request2DMap") == "/re_comm/request_2d_map"


def test_client_of_roboearth_is_answered(start_ros: Callable[..., None], tmp_path: Path) -> None:
    import rclpy
    from rce_knowledge.node import KnowledgeNode
    from rclpy.executors import SingleThreadedExecutor
    from re_msgs.msg import File
    from re_srvs.srv import GetObject, QueryObjects, SetObject
    from std_msgs.msg import String

    start_ros()
    with direct_knowledge(tmp_path) as knowledge:
        node, client = KnowledgeNode(knowledge), rclpy.create_node("client")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.add_node(client)

        def call(kind: Any, name: str, **fields: Any) -> Any:
            asking: Any = client.create_client(kind, f"/re_comm/{name}")
            spin_until(executor, asking.service_is_ready)
            answer = asking.call_async(kind.Request(**fields))
            spin_until(executor, answer.done)
            return answer.result()

        changes: list[str] = []
        client.create_subscription(String, "/re_comm/changes", lambda message: changes.append(message.data), 100)
        spin_until(executor, lambda: node._follower._after is not None)
        new = {"cls": "cup", "id": "blue", "object": CUP, "files": [File(name="a", data=[1, -1])]}
        assert not call(SetObject, "set_object", **new).success
        assert call(SetObject, "set_object", **new, apiKey="key").success
        found = call(GetObject, "get_object", objectUID="cup.blue")
        assert (found.success, found.object, found.filenames) == (True, CUP, ["a"])
        assert not call(GetObject, "get_object", objectUID="cup.red").success
        assert call(QueryObjects, "query_objects", query="rubbish").result == ""
        assert len([name for name, _ in node.get_service_names_and_types_by_node("rce_knowledge", "/")]) > 26
        spin_until(executor, lambda: len(changes) == 2)
        told = [(each["action"], each["uid"]) for each in map(json.loads, changes)]
        assert told == [("added", "cup.blue"), ("changed", "cup.blue")]
        executor.shutdown()
        client.destroy_node()
        node.destroy_node()
