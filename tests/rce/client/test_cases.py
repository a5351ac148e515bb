"""The programs of all languages have the cases of one table."""

from __future__ import annotations

import re

import pytest

from tests.support.client_cases import ABSENT, CASES, CPP, JAVASCRIPT, PYTHON, expected
from tests.support.client_contract import ClientContract
from tests.support.paths import TESTS


def test_python_has_the_cases() -> None:
    names = {name.removeprefix("test_").replace("_", " ") for name in vars(ClientContract) if name.startswith("test_")}
    assert names == expected(PYTHON)


def test_javascript_has_the_cases() -> None:
    contract = (TESTS / "js" / "client_contract.js").read_text()
    assert set(re.findall(r'^  async "(.+)"\(', contract, re.M)) == expected(JAVASCRIPT)


def test_cpp_has_the_cases() -> None:
    sources = "".join(path.read_text() for path in (TESTS / "cpp").glob("*.cpp"))
    assert set(re.findall(r'^ +(?:return \{)?\{"([a-z0-9 ]+)", \w+\}', sources, re.M)) == expected(CPP)


@pytest.mark.parametrize("language", [PYTHON, JAVASCRIPT, CPP])
def test_absent_cases_are_of_the_table(language: str) -> None:
    assert ABSENT[language].keys() <= CASES.keys()
