"""Robot files for tests."""

from __future__ import annotations

from typing import Any

from tests.support.client_contract import SET_BOOL, STRING


def robot_file(url: str = "http://127.0.0.1:9000/") -> dict[str, Any]:
    """Return a robot file like the original's test/debug.cfg, with every kind of interface on the robot."""

    def own(tag: str, kind: str, name: str) -> dict[str, str]:
        return {"eTag": "a", "iTag": tag, "iType": kind, "iCls": name, "addr": f"/{tag}"}

    return {
        "url": url,
        "userID": "testUser",
        "robotID": "a",
        "password": "testUser",
        "containers": [{"cTag": "c1"}, {"cTag": "c2", "group": "net", "size": 2}],
        "parameters": [{"cTag": "c1", "name": "list", "value": ["one", 2, "three", "true"]}],
        "nodes": [{"cTag": "c1", "nTag": "echo", "pkg": "Test", "exe": "stringEcho.py", "args": "--x"}],
        "interfaces": [
            {"eTag": "c1", "iTag": "req", "iType": "PublisherInterface", "iCls": STRING, "addr": "/req"},
            own("out", "SubscriberConverter", STRING),
            own("in", "PublisherConverter", STRING),
            own("raw_out", "SubscriberForwarder", STRING),
            own("raw_in", "PublisherForwarder", STRING),
            own("call", "ServiceProviderConverter", SET_BOOL),
            own("serve", "ServiceClientConverter", SET_BOOL),
        ],
        "connections": [
            {"tagA": "a/out", "tagB": "a/in"},
            {"tagA": "a/raw_in", "tagB": "a/raw_out"},
            {"tagA": "a/call", "tagB": "a/serve"},
        ],
    }
