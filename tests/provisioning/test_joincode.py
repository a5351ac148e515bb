"""Join codes as the plan reads them."""

from __future__ import annotations

import pytest

from provisioning import (
    joincode,
)
from provisioning.steps import ProvisioningError
from rce.api.joining import Invitation, JoinCode, parse_join_code
from rce.errors import InvalidRequest
from tests.support.provisioning.systems import join_code


@pytest.mark.parametrize("text", ["", "nonsense", "rce1-", "rce1-e30", "rce1-ÿ"])
def test_malformed_code_is_refused(text: str) -> None:
    with pytest.raises(InvalidRequest, match="join code"):
        parse_join_code(text)
    with pytest.raises(ProvisioningError, match="not a complete join code"):
        joincode.parse(text)


def test_code_of_the_master_is_decoded() -> None:
    invitation = Invitation("beta", ["container"], 1, "s")
    code = JoinCode("https://10.0.0.1:8081/", "ab", invitation)
    plan = joincode.parse(f"  {code.text()}\n")
    assert (plan.url, plan.name, plan.roles) == (code.url, "beta", ("container",))
    assert parse_join_code(code.text()) == code


def test_code_may_contain_line_breaks() -> None:
    text = join_code("container")
    assert joincode.parse(f"{text[:20]}\n {text[20:]}").name == "beta"
