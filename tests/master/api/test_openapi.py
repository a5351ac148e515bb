"""OpenAPI document of the API: valid, complete, and true for random requests."""

from __future__ import annotations

import asyncio
import os
import re
import sys
from pathlib import Path

import pytest
from openapi_spec_validator import validate

from tests.support.master.served import Served
from tests.support.paths import TESTS
from tests.support.programs import run_program


async def test_document_is_valid_and_public(served: Served) -> None:
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


LEFT_OUT = ("/api/v1/events", "/api/v1/live")
"""Endless answers."""
OF_TUS = ("post_api_v_recordings", "patch_api_v_recordings_machine_recording")
"""Operations whose headers are those of tus, which the document does not repeat."""


@pytest.mark.slow
async def test_random_requests_are_answered_as_the_document_says(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Schemathesis with a seed: good and bad requests to each operation, as an operator who has a robot."""
    monkeypatch.setattr(served.master.users.throttle, "check", lambda name, address: None)  # it tries bad passwords
    await served.robot("olga", "r1")
    secret, _ = await served.master.users.keys.add("olga", "operator")
    words = [
        *(str(Path(sys.executable).with_name("st")), "run", f"{served.url}/api/v1/openapi.json"),
        *("--header", f"Authorization: Bearer {secret}", "--seed", "1", "--max-examples", "1", "--no-color"),
        *("--generation-database", "none", "--request-timeout", "20", "--continue-on-failure"),
        *("--phases", "coverage,fuzzing"),
        *(word for path in LEFT_OUT for word in ("--exclude-path", path)),
        *("--exclude-operation-id", "delete_api_v_keys_key", "--exclude-operation-id", "post_api_v_keys_key_rotate"),
        *(word for id in OF_TUS for word in ("--exclude-operation-id", id)),
        # A declaration of a service has so many fields within others that trying them takes longer than all the rest.
        *("--exclude-operation-id", "post_api_v_catalogue"),
    ]
    variables = {"SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(TESTS / "support" / "master")}
    nothing = asyncio.subprocess.DEVNULL
    status, out, err = await run_program(*words, seconds=400, cwd=tmp_path, env=os.environ | variables, stdin=nothing)
    assert status == 0, out + err
