"""`rce service publish`: the file, and the package beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rce.api.views import NewOffer, OfferView
from rce.cli.lazy import publish
from rce.errors import InvalidRequest
from tests.support.console import Console

DECLARATION = "name: echo\ntakes: {say: std_msgs/String}\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "service.yaml"
    path.write_text(DECLARATION)
    return path


def test_file_is_published(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = Console(OfferView("ann", NewOffer("echo"), [], {})).request(f"service publish {file} --share bob")
    assert (made.line, made.body["share"]) == ("POST catalogue", ["bob"])
    assert capsys.readouterr().out == "ann/echo: for bob\n"


def test_package_beside_it_is_pushed_and_used(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (file.parent / "package.xml").write_text("<package/>")
    monkeypatch.setattr(publish, "push", lambda session, directory: f"tool@{directory.name}")
    made = Console(OfferView("ann", NewOffer("echo"), [], {})).request(f"service publish {file.parent}")
    assert made.body["environment"]["packages"] == [f"tool@{file.parent.name}"]


def test_file_may_declare_several_services(file: Path) -> None:
    file.write_text("- {name: a}\n- {name: b}\n")
    assert [each.name for each in publish.declarations(file)] == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "said"), [("[]", "no service"), ("name: a\ntake: {}", "takes"), ("takes: {}", "name"), ("3", "object")]
)
def test_wrong_file_is_refused_with_its_place(file: Path, text: Any, said: str) -> None:
    file.write_text(text)
    with pytest.raises(InvalidRequest, match=said):
        publish.declarations(file)
