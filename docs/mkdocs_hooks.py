"""Hooks of mkdocs.yml: pages made of files that lie above docs/, and links between both that work on the site, too."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PAGES = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md", "README.md": "getting-started.md"}
"""Names of files in the checkout's root, and of the pages that stand for them on the site."""
LINK = re.compile(r"\[([^\]]*)\]\(([^)#:]+)(#[^)]*)?\)")


def on_files(files: Files, *, config: Any) -> Files:
    """Add the pages that are made of files in the checkout's root."""
    for name, page in PAGES.items():
        text = LINK.sub(_link_from_root, (ROOT / name).read_text())
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Lead links from a page to files in the checkout's root to the pages that stand for them."""
    directory = Path(page.file.src_uri).parent
    up = "../" * len(directory.parts)

    def replace(match: re.Match[str]) -> str:
        text, target, anchor = match[1], match[2], match[3] or ""
        name = target.removeprefix(f"{up}../")
        return f"[{text}]({up}{PAGES[name]}{anchor})" if name != target and name in PAGES else match[0]

    return LINK.sub(replace, markdown)


def _link_from_root(match: re.Match[str]) -> str:
    text, target, anchor = match[1], match[2], match[3] or ""
    if target.startswith("docs/"):
        return f"[{text}]({target.removeprefix('docs/')}{anchor})"
    return f"[{text}]({PAGES[target]}{anchor})" if target in PAGES else f"{text} (`{target}`)"
