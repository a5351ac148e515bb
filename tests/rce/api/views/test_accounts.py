"""Users, keys and the audit log in requests and responses."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rce.api.roles import UNRESTRICTED
from rce.api.views.accounts import AuditView, NewKey, NewPassword, NewUser, UserChanges


def test_origin_of_an_action_is_its_door_and_address() -> None:
    entry = AuditView(1, 5.0, "ann", "", "login", "ann", "ok", "rest", "10.0.0.1")
    assert entry.origin == "rest 10.0.0.1"
    assert msgspec.structs.replace(entry, door="offline", address="").origin == "offline"


def test_key_is_unrestricted_and_permanent_by_default() -> None:
    key = msgspec.convert({}, NewKey)
    assert (key.role, key.label, key.expires, key.scopes) == (None, "", None, UNRESTRICTED)


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        (NewKey, {"label": "x" * 201}),
        (NewKey, {"expires": 0}),
        (NewKey, {"expires": 1e11}),
        (NewKey, {"role": "emperor"}),
        (NewKey, {"expiry": 5}),
        (NewUser, {"name": "ann"}),
        (NewUser, {"name": "ann", "password": "x", "admin": True}),
        (UserChanges, {}),
        (UserChanges, {"role": "user", "name": "bob"}),
        (NewPassword, {"old": "x"}),
    ],
)
def test_wrong_request_is_refused(kind: type[Any], body: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(body, kind)


def test_new_user_has_no_special_rights() -> None:
    assert msgspec.convert({"name": "ann", "password": "x"}, NewUser).role == "user"
