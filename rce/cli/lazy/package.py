"""Implementation of `rce package`."""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from rce.api.http import EntryClient, basic
from rce.cli import output
from rce.cli.contexts import running_platform
from rce.cli.session import ConsoleSession
from rce.errors import StartFailed
from rce.packages import ament_python, layout
from rce.packages.archive import Entry
from rce.packages.client import Package, PackagesClient
from rce.spelling import counted

TYPE_SUPPORT = "provisioning.typesupport"
LAST_LINES = 40  # printed of a build that failed
DIGEST_DIGITS = 12  # printed of a version's digest


def push(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Push a directory as the newest version of a package, and share it if asked to."""
    packages, user = _connect(args)
    with tempfile.TemporaryDirectory(prefix="rce-") as scratch:
        directory = args.directory if args.as_is else ament_python.install(args.directory, Path(scratch))
        found = layout.read(directory, args.as_is)
        entries = list(found.entries)
        if found.interfaces and not args.text_only:
            entries += build_type_support(found.interfaces)
        name = args.name or found.name
        contents = packages.push(name, entries)
        if args.share:
            packages.share(name, _user_names(args.share))
    print(
        f"{user}/{name}@{contents.digest[:DIGEST_DIGITS]}: {', '.join(contents.packages)}; "
        f"{counted(contents.files, 'file')}, {contents.size / 1e6:.1f} MB"
    )


def list_packages(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print the packages that the user may use."""
    packages, _ = _connect(args)
    print_packages(packages.list(), args.json)


def share(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Share a package with other users."""
    packages, _ = _connect(args)
    packages.share(args.name, _user_names(args.users))


def unshare(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Stop sharing a package."""
    packages, _ = _connect(args)
    packages.unshare(args.name, _user_names(args.users))


def remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Remove a package, or one version of it."""
    packages, _ = _connect(args)
    packages.remove(*args.name.partition("@")[::2])


def _connect(args: argparse.Namespace) -> tuple[PackagesClient, str]:
    """Return the client of the platform's packages, and the name of the user."""
    access = running_platform(args)
    secret = access.key or hashlib.sha256((access.password or "").encode()).hexdigest()  # as robots send it
    return PackagesClient(EntryClient(access.url, basic(access.user, secret))), access.user


def build_type_support(interfaces: list[Path]) -> list[Entry]:
    """Build the type support of interface packages and return its files.

    Provisioning builds it in its cache, apart from the type support that this machine's platform uses.

    Raises:
        StartFailed: Provisioning is not installed, or the build failed.
    """
    if find_spec("provisioning") is None:
        raise StartFailed("building type support needs the package `provisioning`, which is not installed")
    with tempfile.TemporaryDirectory() as directory:
        copies = [layout.copy_interfaces(path, Path(directory)) for path in interfaces]
        command = [sys.executable, "-P", "-m", TYPE_SUPPORT, "--alone", *map(str, copies)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        names = ", ".join(path.name for path in interfaces)
        reason = "\n".join(done.stderr.strip().splitlines()[-LAST_LINES:]) or f"status {done.returncode}"
        raise StartFailed(
            f"the build of type support for {names} failed: {reason}\n"
            "It needs ROS 2 (pip install '.[ros]' in a checkout of RCE) and g++ on this machine; or push with "
            "--text-only if the environment's image has the type support"
        )
    return layout.type_support(Path(done.stdout.strip()), interfaces)


def print_packages(packages: list[Package], as_json: bool) -> None:
    """Print packages with their versions, newest first."""
    if as_json:
        print(output.to_json(packages))
        return
    if not packages:
        print("no packages; `rce package push DIR` makes the first", file=sys.stderr)
    for package in packages:
        shared = "everybody" if "*" in package.shared else ", ".join(package.shared)
        print(package.name + (f"  (shared with {shared})" if shared else ""))
        for version in reversed(package.versions):
            created = output.local_time(version.created)[: len("2000-01-01 00:00")]
            digest = version.digest[:DIGEST_DIGITS]
            start = f"    {digest}  {created}  {version.size / 1e6:8.1f} MB  "
            print(output.hanging(start, ", ".join(version.packages)))


def _user_names(users: list[str]) -> list[str]:
    return ["*" if user == "all" else user for user in users]
