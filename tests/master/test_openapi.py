"""The description of the API: valid, complete, and true, as far as random requests can tell."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from openapi_spec_validator import validate
from served import Served, serve
from twisted.internet.base import ReactorBase


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    async with serve(reactor, tmp_path) as served:
        yield served


async def test_the_document_is_valid_and_open_to_all(served: Served) -> None:
    answer = await served.ask("GET", "/openapi.json", "")
    assert answer.status == 200
    validate(answer.body)
    operations = [each for path in answer.body["paths"].values() for each in path.values()]
    ids = [each["operationId"] for each in operations]
    assert len(ids) == len(set(ids))
    assert all(each["summary"] for each in operations)
    described = {name for each in operations for name in re.findall(r"{(\w+)}", str(each)) if "{" in name}
    assert not described
    create = answer.body["paths"]["/api/v1/environments"]["post"]
    assert create["requestBody"]["content"]["application/json"]["schema"]["$ref"].endswith("/NewEnvironment")
    assert [each["name"] for each in create["parameters"]] == ["user", "Idempotency-Key"]
    log = answer.body["paths"]["/api/v1/environments/{environment}/log"]["get"]["responses"]["200"]["content"]
    assert log.keys() == {"application/json", "text/event-stream"}
