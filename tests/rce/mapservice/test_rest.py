"""REST interface of the map service: authentication, errors, OpenAPI document, audit log and metrics."""

from __future__ import annotations

import base64

import pytest

from rce.errors import Unavailable
from tests.support.map_service import Service


async def test_jobs_and_uploads_of_other_users_are_not_found(service: Service) -> None:
    job, upload = await service.submit(), await service.upload()
    for method, path in (
        *(("GET", f"/jobs/{job}"), ("GET", f"/jobs/{job}/events"), ("POST", f"/jobs/{job}/cancel")),
        *(("DELETE", f"/jobs/{job}"), ("GET", f"/uploads/{upload}"), ("DELETE", f"/uploads/{upload}")),
        ("GET", f"/jobs/{job}/files/log.txt"),
    ):
        assert (await service.request(method, path, "bob")).status == 404, path
    answer = await service.request("POST", "/jobs", "bob", json={"uploads": [upload]})
    assert answer.status == 404


BASIC = base64.b64encode(b"ann:rce_ann").decode()


@pytest.mark.parametrize(
    ("query", "header", "status"),
    [
        ("", "", 401),
        ("", "Bearer rce_ann", 200),
        ("?userID=bob", "Bearer rce_ann", 401),
        ("", "Bearer rce_nobody", 401),
        ("", f"Basic {BASIC}", 200),
        ("", "Basic %%%", 401),
        ("", "Basic é", 401),
        ("?key=rce_ann", "", 200),
        ("?userID=ann&key=rce_ann", "", 200),
        ("?userID=ann&password=wrong", "", 401),
    ],
)
async def test_credentials(service: Service, query: str, header: str, status: int) -> None:
    headers = {"Authorization": header} if header else {}
    for path in ("/jobs", "/uploads"):
        answer = await service.session.get(service.url + path + query, headers=headers)
        assert answer.status == status
        assert ("WWW-Authenticate" in answer.headers) == (status == 401)


async def test_unreachable_master_is_answered_with_unavailable(service: Service) -> None:
    service.master.failure = Unavailable("no connection to the Master")
    answer = await service.request("GET", "/jobs")
    assert (answer.status, (await answer.json())["code"]) == (503, "unavailable")
