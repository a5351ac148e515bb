"""`python -m rce.schema`: the JSON Schema of the protocol between robots and the platform, from its types."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from rce import messages as m

FROM_ROBOT: dict[str, Any] = {
    "CC": m.CreateContainer,
    "DC": m.DestroyContainer,
    "CN": m.ConfigureComponents,
    "CX": m.ConfigureConnections,
    "DM": m.DataMessage,
}


def schema() -> dict[str, Any]:
    """Frames by `type`; the lists of CN and CX refer to the types of their items."""
    kinds = [*FROM_ROBOT.values(), m.Status, m.Failure, *m.CN_ITEMS.values(), *m.CX_ITEMS.values()]
    found, components = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    by_kind = dict(zip(kinds, found, strict=True))
    for lists, items in ((m.ConfigureComponents, m.CN_ITEMS), (m.ConfigureConnections, m.CX_ITEMS)):
        for name, kind in items.items():
            components[lists.__name__]["properties"][name]["items"] = by_kind[kind]
    frame_id = msgspec.json.schema(m.FrameId)
    from_robot = [
        {
            "type": "object",
            "properties": {"type": {"const": name}, "data": by_kind[kind], "id": frame_id},
            "required": ["type", "data"],
        }
        for name, kind in FROM_ROBOT.items()
    ]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Text frames between robots and the platform, version {m.CURRENT_VERSION}",
        "anyOf": [*from_robot, by_kind[m.Status], by_kind[m.Failure]],
        "$defs": components,
    }


if __name__ == "__main__":
    print(json.dumps(schema(), indent=2))
