"""The first hour of a robot developer, an administrator and an operator, from a fresh clone.

They work in a terminal and a browser, and do only what README and docs say.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path

import cv2
import pytest

from tests.support.e2e.browser_guide import follow
from tests.support.e2e.chromium import chromium, open_page, sign_in
from tests.support.e2e.installation import image_directory, install_and_remove
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.e2e.shell import PROMPT, Shell
from tests.support.paths import ROOT

INSTALLATION = 480.0  # seconds; about 70 on an idle machine with the caches of pip and uv filled


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh clone, in which nothing is installed."""
    if not (ROOT / ".git").exists():
        pytest.skip("needs a checkout by git")
    directory = tmp_path_factory.mktemp("hour") / "rce"
    subprocess.run(["git", "clone", "--quiet", ROOT, directory], check=True)
    return directory


@pytest.fixture(scope="module")
async def installed(clone: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The clone after the first command of the README."""
    demo = block((clone / "README.md").read_text(), "sh", "Try it").partition("#")[0].strip()
    async with Shell(tmp_path_factory.mktemp("demo"), clone) as shell:
        await shell.run(demo, seconds=INSTALLATION)
    return clone


def block(text: str, language: str, heading: str) -> str:
    """Return the first code block of a language below a heading of a document."""
    _, _, section = text.partition(f"\n## {heading}\n")
    found = re.search(rf"```{language}\n(.*?)```", section, re.S)
    assert found, f"no {language} below {heading}"
    return found[1]


async def test_robot_developer(installed: Path, tmp_path: Path) -> None:
    """The map of the demo, a platform, a first robot, the console, and the first steps that the dashboard shows."""
    picture = cv2.imread(str(installed / "rce-demo" / "map.png"), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert picture.std() > 20  # rooms, walls and what is unknown
    readme = (installed / "README.md").read_text()
    async with Shell(tmp_path, installed) as server, Shell(tmp_path, installed) as user:
        assert "`source .venv/bin/activate`" in readme
        for shell in (server, user):
            await shell.run("source .venv/bin/activate")
        assert "`--allow-root`" in readme
        server.type(f"rce up --dev --http-port 0 {'--allow-root' if os.geteuid() == 0 else ''}\n")
        url = re.findall(r"ready (http://\S+)", await server.expect(r"ready http://\S+\r"))[0]

        program = block(readme, "python", "A first robot").replace("http://127.0.0.1:9000/", url)
        (tmp_path / "first.py").write_text(program)
        assert "{'data': 'hello cloud'}" in await user.run(f"python {tmp_path}/first.py")
        await user.run(f"rce login {url}", ("User: ", USER), (f"Password of {USER}: ", USER))
        await user.run("rce env list")

        async with chromium() as browser, open_page(browser) as (page, _):
            await sign_in(page, url, USER, USER)
            await page.get_by_role("button", name="Try a simulated robot").click()
            lines = await page.get_by_role("dialog").locator("pre").inner_text()
            await page.get_by_role("button", name="Close").click()
            user.type(f"export RCE_PASSWORD={USER}\n{lines.splitlines()[-1]} --out {tmp_path}/map; echo mapped: $?\n")
            await page.get_by_role("link", name=re.compile("map")).first.wait_for()
            await user.expect(r"mapped: 0\r", INSTALLATION)
        server.type("\x03")
        await server.expect("<0>$")


async def test_administrator_at_the_console(installed: Path, tmp_path: Path) -> None:
    guide = installed / "docs" / "walkthrough-console.md"
    home = tmp_path / "home"
    home.mkdir()
    async with (
        RealPlatform(tmp_path, dev=False, program=str(installed / ".venv" / "bin" / "rce")) as platform,
        Shell(home, home) as shell,
    ):
        found = re.search(r"'admin' with password '(\S+)'", platform.output)
        assert found, platform.output
        await shell.run(f"source {installed}/.venv/bin/activate; PS1='{PROMPT}'")
        replaced = {"http://127.0.0.1:9000/": platform.url, "ADMIN-PASSWORD": found[1]}
        assert await shell.follow(guide, replaced) > 20


async def test_administrator_in_the_browser(installed: Path, tmp_path: Path) -> None:
    async with (
        chromium() as browser,
        RealPlatform(tmp_path, dev=False, program=str(installed / ".venv" / "bin" / "rce")) as platform,
        open_page(browser) as (page, _),
    ):
        guide = (installed / "docs" / "walkthrough-browser.md").read_text()
        assert await follow(guide, page, platform) > 30


def test_operator(clone: Path, tmp_path: Path) -> None:
    """`provision install` on a system of its own, a robot, a second machine, `doctor`, `uninstall`."""
    with image_directory(tmp_path, clone) as place:
        lines = install_and_remove(place, clone)
    assert "robot: connected" in lines
    assert "machine: ca.pem cert.pem key.pem membership.json " in lines
    assert "refused" in lines  # the code is valid once
    findings = json.loads(next(line for line in lines if line.startswith("[")))
    assert {finding["level"] for finding in findings} <= {"ok", "warn"}
    checked = {"master", "clock", "cert.pem", *(f"port {number}" for number in (9000, 9040, 9050))}
    assert checked <= {finding["about"] for finding in findings}
    assert "doctor: ok" in lines
    assert lines[-1] == "left:  0"
