"""JSON Schema of the protocol in the documentation."""

import json

from rce.protocol.schema import schema
from tests.support.paths import ROOT

DOCUMENT = ROOT / "docs" / "protocol.schema.json"


def test_schema_in_the_documentation_is_up_to_date() -> None:
    assert json.loads(DOCUMENT.read_text()) == schema(), "run python -m rce.protocol.schema > docs/protocol.schema.json"
