"""The schema in the documentation is the one that the types give."""

import json
from pathlib import Path

from rce.schema import schema

DOCUMENT = Path(__file__).parents[2] / "docs" / "protocol.schema.json"


def test_documentation_is_up_to_date() -> None:
    assert json.loads(DOCUMENT.read_text()) == schema(), "run python -m rce.schema > docs/protocol.schema.json"
