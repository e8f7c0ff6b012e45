"""Distributions with plugins, put into a folder of their own and made visible for a while."""

from __future__ import annotations

import configparser
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import solvers
from opfmodel import plugins


def install(source: Path, target: Path) -> None:
    """Put the package of ``source/setup.cfg`` into ``target`` with its metadata, as pip does.

    Nothing is built and nothing downloaded; ``test_plugins`` compares it with what pip makes.
    """
    config = configparser.ConfigParser()
    config.read(source / "setup.cfg")
    package = config["options"]["packages"]
    shutil.copytree(source / package, target / package, ignore=shutil.ignore_patterns("__pycache__"))
    points = {
        group: dict(line.split("=", 1) for line in lines.strip().splitlines())
        for group, lines in config["options.entry_points"].items()
    }
    metadata(target, config["metadata"]["name"], points)


def metadata(target: Path, name: str, points: Mapping[str, Mapping[str, str]]) -> None:
    """Write the metadata of a distribution that provides entry points."""
    folder = target / f"{name.replace('-', '_')}-1.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = []
    for group, members in points.items():
        lines += [f"[{group}]", *(f"{key.strip()} = {value.strip()}" for key, value in members.items())]
    (folder / "entry_points.txt").write_text("\n".join(lines) + "\n")


@contextmanager
def visible(target: Path) -> Iterator[None]:
    """Let this process find what is in ``target``, and forget it afterwards."""
    before = set(sys.modules)
    sys.path.insert(0, str(target))
    rescan()
    try:
        yield
    finally:
        sys.path.remove(str(target))
        for name in set(sys.modules) - before:
            if str(getattr(sys.modules[name], "__file__", None) or "").startswith(str(target)):
                del sys.modules[name]
        rescan()


def rescan() -> None:
    plugins.rescan()
    solvers.rescan()
