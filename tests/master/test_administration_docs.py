"""Rights and limits in docs/administration.md are those of the code."""

from __future__ import annotations

from master.access import passwords, throttle
from master.access.rights import COLUMNS, RIGHTS
from master.graph.limits import Policy
from tests.support.paths import ROOT

TEXT = (ROOT / "docs" / "administration.md").read_text()


def test_table_of_rights() -> None:
    rows = [
        [cell.strip(" `") for cell in line.split("|")[1:-1]] for line in TEXT.splitlines() if line.startswith("| `")
    ]
    found = {
        row[0]: dict(zip(COLUMNS, (cell or "-" for cell in row[1:]), strict=True)) for row in rows if len(row) == 7
    }
    assert found == RIGHTS


def test_numbers() -> None:
    for said in (
        f"At least {passwords.MIN_LENGTH} characters",
        f"After {throttle.FREE_BY_USER} wrong passwords for a name, or {throttle.FREE_BY_ADDRESS} from an address",
        f"up to {throttle.MAX_WAIT / 60:g} minutes; after {throttle.FORGET_AFTER / 60:g} minutes",
    ):
        assert said in TEXT.replace("\n", " "), said


def test_every_limit_is_documented() -> None:
    for name in Policy.__struct_fields__:
        assert f"`{name}`" in TEXT or name.startswith("default_"), name
