"""The first hour of new users: from a fresh clone, in a terminal and a browser, with what README and docs say only."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import cv2
import pytest

from tests.support.e2e.chromium import chromium, open_page, sign_in
from tests.support.e2e.real_platform import USER
from tests.support.e2e.shell import Shell
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


def block(text: str, language: str, heading: str) -> str:
    """Return the first code block of a language below a heading of a document."""
    _, _, section = text.partition(f"\n## {heading}\n")
    found = re.search(rf"```{language}\n(.*?)```", section, re.S)
    assert found, f"no {language} below {heading}"
    return found[1]


async def test_robot_developer(clone: Path, tmp_path: Path) -> None:
    """The demo, a platform, a first robot, the console, and the first steps that the dashboard shows."""
    readme = (clone / "README.md").read_text()
    demo = block(readme, "sh", "Try it").partition("#")[0].strip()
    async with Shell(tmp_path, clone) as server, Shell(tmp_path, clone) as user:
        await server.run(demo, seconds=INSTALLATION)
        picture = cv2.imread(str(clone / "rce-demo" / "map.png"), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        assert picture.std() > 20  # rooms, walls and what is unknown

        assert "source .venv/bin/activate" in readme
        for shell in (server, user):
            await shell.run("source .venv/bin/activate")
        assert "`--allow-root`" in readme
        server.type(f"rce up --dev --http-port 0 {'--allow-root' if os.geteuid() == 0 else ''}\n")
        url = re.findall(r"ready (http://\S+)", await server.expect(r"ready http://\S+\r"))[0]

        program = block(readme, "python", "A first robot").replace("http://127.0.0.1:9000/", url)
        (clone / "first.py").write_text(program)
        assert "{'data': 'hello cloud'}" in await user.run("python first.py")
        await user.run(f"rce login {url}", ("User: ", USER), (f"Password of {USER}: ", USER))
        await user.run("rce env list")

        async with chromium() as browser, open_page(browser) as (page, _):
            await sign_in(page, url, USER, USER)
            await page.get_by_role("button", name="Try a simulated robot").click()
            lines = await page.get_by_role("dialog").locator("pre").inner_text()
            await page.get_by_role("button", name="Close").click()
            user.type(f"export RCE_PASSWORD={USER}\n{lines.splitlines()[-1]}; echo mapped: $?\n")
            await page.get_by_role("link", name=re.compile("map")).first.wait_for()
            await user.expect(r"mapped: 0\r", INSTALLATION)
        server.type("\x03")
        await server.expect("<0>$")
