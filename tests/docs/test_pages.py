"""The documentation names only files, pages and links that exist, and its site can be built."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.support.paths import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TEXTS = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PACKAGES = "rce|master|endpoints|containers|converters|provisioning|tests|docs|changelog.d"
PATH = re.compile(rf"(?<![\w./~-])(?:{PACKAGES})/[\w./-]*\w(?:\.\w+)")
FOLDER = re.compile(rf"`((?:{PACKAGES})/[\w./-]+)`")
MODULE = re.compile(r"`(\w+\.py)`")
LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
ANCHORED = re.compile(r"\]\(([^)#:\s]*)#([^)]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.M)
IMAGES = {"rce/base", "rce/mapping", "rce/mapping3d", "rce/agent"}  # of containers
USERS_FILES = {"setup.py", "talker.py", "packed_scan.py"}  # of packages that users push, and of converters
MADE_BY_THE_HOOKS = {"getting-started.md", "contributing.md", "changelog.md"}


def ids(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("page", TEXTS, ids=ids)
def test_named_files_exist(page: Path) -> None:
    text = page.read_text()
    named = {*PATH.findall(text), *FOLDER.findall(text)} - IMAGES
    named = {path for path in named if not path.rpartition("/")[2].isupper()}  # placeholders, such as containers/NAME
    assert [path for path in sorted(named) if not (ROOT / path).exists()] == []


@pytest.mark.parametrize("page", TEXTS, ids=ids)
def test_named_modules_exist(page: Path) -> None:
    known = {path.name for package in PACKAGES.split("|") for path in (ROOT / package).rglob("*.py")}
    assert set(MODULE.findall(page.read_text())) - known - USERS_FILES == set()


@pytest.mark.parametrize("page", TEXTS, ids=ids)
def test_links_lead_to_files(page: Path) -> None:
    assert [link for link in LINK.findall(page.read_text()) if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", TEXTS, ids=ids)
def test_links_lead_to_headings(page: Path) -> None:
    missing = []
    for file, anchor in ANCHORED.findall(page.read_text()):
        target = page.parent / file if file else page
        if target.suffix == ".md" and anchor not in map(slug, HEADING.findall(target.read_text())):
            missing.append(f"{file}#{anchor}")
    assert missing == []


def slug(heading: str) -> str:
    """Return the anchor of a heading, which is the same on the site and in a repository's browser."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def test_navigation_has_every_page() -> None:
    text = re.sub(r"!!python\S+", "", (ROOT / "mkdocs.yml").read_text())
    named: list[str] = []

    def collect(entry: object) -> None:
        if isinstance(entry, str):
            named.append(entry)
        elif isinstance(entry, dict):
            collect(list(entry.values()))
        elif isinstance(entry, list):
            for each in entry:
                collect(each)

    collect(yaml.safe_load(text)["nav"])
    assert sorted(named) == sorted({str(page.relative_to(DOCS)) for page in PAGES} | MADE_BY_THE_HOOKS)


@pytest.mark.slow
def test_site_builds_and_loads_nothing_from_other_hosts(tmp_path: Path) -> None:
    pytest.importorskip("material", reason="needs MkDocs: pip install '.[docs]'")
    pytest.importorskip("mkdocstrings", reason="needs mkdocstrings: pip install '.[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    loaded = re.compile(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"?(https?:)?//")
    assert [page.name for page in tmp_path.rglob("*.html") if loaded.search(page.read_text())] == []
    client = (tmp_path / "client.html").read_text()
    names = ("Robot", "Environment", "Publisher", "Subscriber", "ServiceClient", "ServiceProvider", "BlockingRobot")
    assert [name for name in names if f'id="rce.client.{name}' not in client] == []
    errors = ("AlreadyExists", "LimitExceeded", "NoCapacity", "NotFound", "StartFailed", "TimedOut", "RceError")
    linked = set(re.findall(r'<code><a class="autorefs[^>]*href="#rce\.errors\.(\w+)"', client))
    assert [name for name in errors if name not in linked] == []
