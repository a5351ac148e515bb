"""What docs/administration.md says of rights and bounds is what the code has."""

from __future__ import annotations

from pathlib import Path

from master import passwords, throttle
from master.policies import Policy
from master.rights import COLUMNS, RIGHTS

TEXT = (Path(__file__).parents[2] / "docs" / "administration.md").read_text()


def test_the_table_of_rights() -> None:
    rows = [
        [cell.strip(" `") for cell in line.split("|")[1:-1]] for line in TEXT.splitlines() if line.startswith("| `")
    ]
    found = {
        row[0]: dict(zip(COLUMNS, (cell or "-" for cell in row[1:]), strict=True)) for row in rows if len(row) == 7
    }
    assert found == RIGHTS


def test_the_numbers() -> None:
    for said in (
        f"At least {passwords.LEAST} characters",
        f"After {throttle.FREE_OF_USER} wrong passwords for a name, or {throttle.FREE_OF_ADDRESS} from an address",
        f"up to {throttle.LONGEST / 60:g} minutes; after {throttle.FORGET / 60:g} minutes",
    ):
        assert said in TEXT.replace("\n", " "), said


def test_every_limit_is_named() -> None:
    for name in Policy.__struct_fields__:
        assert f"`{name}`" in TEXT or name.startswith("default_"), name
