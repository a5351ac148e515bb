"""Parts that the clients of all services share: credentials and errors."""

from __future__ import annotations

import http.client

import pytest

from rce.client.service_client import Answer, ServiceClient
from rce.errors import InvalidRequest, NotFound


class SomeClient(ServiceClient):
    prefix = "/some-service"


def test_credentials_are_a_key_or_a_password() -> None:
    assert SomeClient("http://a/", key="rce_1").headers == {"Authorization": "Bearer rce_1"}
    assert SomeClient("http://a/", user="u", password="p").headers == {"Authorization": "Basic dTpw"}
    for given in ({}, {"key": "rce_1", "password": "p"}):
        with pytest.raises(InvalidRequest, match="either a password or an API key"):
            SomeClient("http://a/", **given)


def test_answer_of_another_form_names_the_service() -> None:
    client = SomeClient("http://a/", key="k")
    body = b'{"title": "Not found", "status": 404, "code": "not_found", "detail": "gone"}'
    problem = client.error(Answer(404, http.client.HTTPMessage(), body))
    assert (type(problem), str(problem)) == (NotFound, "gone")
    error = client.error(Answer(502, http.client.HTTPMessage(), b"<html>"))
    assert str(error) == "the some service answered with HTTP status 502"
