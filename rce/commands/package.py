"""`rce package`: a user's own ROS packages at a running platform."""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

import msgspec

from rce import layout
from rce.archive import Entry
from rce.commands.platform import access, add_command, add_entry
from rce.errors import InvalidRequest, StartFailed
from rce.http import Entry as HttpEntry
from rce.http import basic
from rce.packages import Package, Packages

TYPE_SUPPORT = "provisioning.typesupport"
SHOWN_DIGITS = 12


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(
        prog="rce package",
        description="Your own ROS 2 packages at a running platform. Environments get them by name: `packages` of "
        "containerData, or robot.create_environment(..., packages=[...]).",
    )
    commands = whole.add_subparsers(dest="command", required=True)
    push = commands.add_parser(
        "push",
        help="push packages as they are: Python in sources, or an install space",
        description="Push DIR as the newest version of a package: a ROS package in Python, a directory of several, or "
        "an install space (of colcon, merged or isolated). Type support of messages and services is built on this "
        "machine. What must be built is refused: `rce image build` makes an image of it.",
    )
    push.add_argument("directory", type=Path, metavar="DIR")
    push.add_argument("--name", default="", help="its name at the platform (default: that of the package or DIR)")
    push.add_argument("--share", action="append", default=[], metavar="USER|all", help="let others use it too")
    push.add_argument("--as-is", action="store_true", help="also what looks as if it had to be built first")
    push.add_argument("--text-only", action="store_true", help="no type support: the environment's image has it")
    listing = add_command(commands, "list", "the packages that you may use")
    listing.add_argument("--json", action="store_true")
    for name, text in (("share", "let others use a package"), ("unshare", "let them use it no more")):
        sharing = add_command(commands, name, text)
        sharing.add_argument("name", metavar="NAME")
        sharing.add_argument("users", nargs="+" if name == "share" else "*", metavar="USER|all")
    remove = add_command(commands, "remove", "remove a package, or one version; what runs with it goes on")
    remove.add_argument("name", metavar="NAME[@VERSION]")
    for each in commands.choices.values():
        group = each.add_argument_group("platform")
        add_entry(group)
    return whole


def main(arguments: list[str]) -> int:
    words = parser().parse_args(arguments)
    found = access(words)
    secret = found.key
    if found.password is not None:
        secret = hashlib.sha256(found.password.encode()).hexdigest()  # as robots send it
    if secret is None:
        raise InvalidRequest(f"who is {found.user}? Set RCE_KEY or RCE_PASSWORD, or give --password", field="password")
    packages = Packages(HttpEntry(found.url, basic(found.user, secret)))
    match words.command:
        case "push":
            push(packages, words, found.user)
        case "list":
            show(packages.list(), words.json)
        case "share":
            packages.share(words.name, _users(words.users))
        case "unshare":
            packages.unshare(words.name, _users(words.users))
        case "remove":
            packages.remove(*words.name.partition("@")[::2])
    return 0


def push(packages: Packages, words: argparse.Namespace, user: str) -> None:
    found = layout.read(words.directory, words.as_is)
    entries = list(found.entries)
    if found.interfaces and not words.text_only:
        entries += type_support(found.interfaces)
    name = words.name or found.name
    contents = packages.push(name, entries)
    if words.share:
        packages.share(name, _users(words.share))
    print(
        f"{user}/{name}@{contents.digest[:SHOWN_DIGITS]}: {', '.join(contents.packages)}; "
        f"{contents.files} files, {contents.size / 1e6:.1f} MB"
    )


def type_support(interfaces: list[Path]) -> list[Entry]:
    """Built by provisioning, in its cache, without changing what the platform of this machine uses."""
    if find_spec("provisioning") is None:
        raise StartFailed("type support of messages is built by the package `provisioning`, which is not installed")
    with tempfile.TemporaryDirectory() as directory:
        copies = [layout.copy_interfaces(path, Path(directory)) for path in interfaces]
        command = [sys.executable, "-P", "-m", TYPE_SUPPORT, "--alone", *map(str, copies)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        names = ", ".join(path.name for path in interfaces)
        raise StartFailed(
            f"the type support of {names} was not built: {done.stderr.strip().splitlines()[-1]}\n"
            "It takes ROS 2 (pip install '.[ros]' in a checkout of RCE) and g++ on this machine; or push with "
            "--text-only where the environment's image has it"
        )
    return layout.type_support(Path(done.stdout.strip()), interfaces)


def show(packages: list[Package], as_json: bool) -> None:
    if as_json:
        print(msgspec.json.encode(packages).decode())
        return
    if not packages:
        print("no packages; `rce package push DIR` makes the first", file=sys.stderr)
    for package in packages:
        shared = "everybody" if "*" in package.shared else ", ".join(package.shared)
        print(package.name + (f"  (shared with {shared})" if shared else ""))
        for version in reversed(package.versions):
            when = time.strftime("%Y-%m-%d %H:%M", time.localtime(version.created))
            digest = version.digest[:SHOWN_DIGITS]
            print(f"    {digest}  {when}  {version.size / 1e6:8.1f} MB  {', '.join(version.packages)}")


def _users(words: list[str]) -> list[str]:
    return ["*" if word == "all" else word for word in words]
