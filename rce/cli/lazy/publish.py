"""Implementation of `rce service publish`."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from msgspec.structs import replace

from rce import structfile
from rce.api import views
from rce.cli.lazy.package import build_type_support
from rce.cli.session import ConsoleSession
from rce.errors import InvalidRequest
from rce.packages import ament_python, layout
from rce.packages.client import PackagesClient

FILE = "service.yaml"


def publish(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Push the package of a directory, if it has one, and publish the services that its file declares."""
    path: Path = args.path / FILE if args.path.is_dir() else args.path
    declared = declarations(path)
    pushed = [push(session, args.path)] if args.path.is_dir() and _has_package(args.path) else []
    share = ["*" if user == "all" else user for user in args.share]
    for each in declared:
        data = replace(each.environment, packages=[*pushed, *each.environment.packages])
        wanted = replace(each, environment=data, share=share or each.share)
        made = session.api.post(views.OfferView, "catalogue", body=wanted)
        print(f"{made.user}/{made.service.name}: for {', '.join(wanted.share).replace('*', 'everybody') or 'you'}")


def declarations(path: Path) -> list[views.NewOffer]:
    """Return the services that a file declares: one, or a list of them.

    Raises:
        InvalidRequest: The file cannot be read, or is wrong; the error says where.
    """
    content = structfile.load(path)
    found = content if isinstance(content, list) else [content]
    if not found:
        raise InvalidRequest(f"{path} declares no service")
    return [structfile.decode(path, each, views.NewOffer) for each in found]


def push(session: ConsoleSession, directory: Path) -> str:
    """Push a directory as the newest version of a package, and return the reference of that version."""
    with tempfile.TemporaryDirectory(prefix="rce-") as scratch:
        found = layout.read(ament_python.install(directory, Path(scratch)))
        entries = list(found.entries)
        if found.interfaces:
            entries += build_type_support(found.interfaces)
        contents = PackagesClient(session.api.entry).push(found.name, entries)
    return f"{found.name}@{contents.digest}"


def _has_package(directory: Path) -> bool:
    return (directory / "package.xml").exists() or any(directory.glob("*/package.xml"))
