"""Which build this process runs: the plain sources, or what mypyc made of some of them. See docs/compiling.md.

Every package imports this before anything else of ours. A compiled module lies beside its source, and Python takes it
first; a process that runs plain is given a finder which sees sources alone. A build that does not belong to the sources
is never run: such a process sees sources alone too, and the ways in refuse with the words in `CURRENT.trouble`.

Standard library only, cheap, and never compiled itself.
"""

from __future__ import annotations

import os
import sys
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, FileFinder, SourceFileLoader

TYPE_CHECKING = False  # checkers know the name; the real one costs more than all that is done here
if TYPE_CHECKING:
    from typing import Any

HOME = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PACKAGES = ("bus", "fsw", "hilsat", "plant_server", "tools")
CHOICE = "HILSAT_BUILD"  # environment: plain, compiled, or unset: what is there
MANIFEST = os.path.join("bus", "compiled.json")  # written last of a build, removed last with it
LIBRARY = os.path.join("bus", "compiled__mypyc")  # put in place first of a build; what the compiled modules share
SOABI = EXTENSION_SUFFIXES[0].strip(".").removesuffix(".so")
MEND = f"run `make compiled`, or go on with the sources: {CHOICE}=plain, or `make plain`"


class Build:
    """What a process runs, in words, and what is wrong with the compiled build or the choice; empty when nothing is."""

    __slots__ = ("trouble", "words")

    def __init__(self, words: str = "plain", trouble: str = "") -> None:
        self.words = words
        self.trouble = trouble

    @property
    def compiled(self) -> bool:
        """Whether compiled modules run."""
        return self.words != "plain"


def find_build(home: str, choice: str) -> Build:
    """What a process runs from the packages in `home`.

    choice : plain, compiled, or empty: compiled where there is a build
    """
    if choice not in ("", "plain", "compiled"):
        return Build(trouble=f"{CHOICE}={choice} is neither plain nor compiled")
    if choice == "plain":
        return Build()
    try:
        with open(os.path.join(home, MANIFEST), encoding="utf-8") as file:
            text = file.read()
    except FileNotFoundError:
        if _has_library(home):
            return Build(trouble=f"a compiled build was begun and not finished; {MEND}")
        return Build(trouble=f"{CHOICE}=compiled, and there is no compiled build; {MEND}" if choice else "")
    except (OSError, UnicodeError) as error:
        return Build(trouble=f"the compiled build cannot be read: {error}; {MEND}")
    return _judge(home, text)


def _judge(home: str, text: str) -> Build:
    import json  # only those who built pay for it

    try:
        manifest = json.loads(text)
        stale = find_stale(home, manifest)
        words = f"compiled: mypyc {manifest['mypy']}, {manifest['soabi']}, {len(manifest['sources'])} modules"
    except (ValueError, KeyError, TypeError, AttributeError):
        stale, words = f"{MANIFEST} is damaged", ""
    return Build(trouble=f"the compiled build is stale: {stale}; {MEND}") if stale else Build(words)


def find_stale(home: str, manifest: dict[str, Any]) -> str:
    """Why a build must not run here: the first reason, in words; empty when it may."""
    if manifest["soabi"] != SOABI:
        return f"it is for {manifest['soabi']}, this is {SOABI}"
    for name, entry in manifest["sources"].items():
        if not _is_same_source(os.path.join(home, name), entry):
            return f"{name} has changed since"
    for name, size in manifest["libraries"].items():
        try:
            if os.stat(os.path.join(home, name)).st_size != size:
                return f"{name} is not what was built"
        except OSError:
            return f"{name} is missing"
    if manifest["librt"]:  # compiled code that works on raw bytes calls it
        from importlib.util import find_spec

        if find_spec("librt") is None:
            return f"the package librt is missing (pip install librt=={manifest['librt']})"
    return ""


def _is_same_source(path: str, entry: dict[str, Any]) -> bool:
    """Size and time are the usual case; the hash is for a file that was copied, or changed and changed back."""
    try:
        status = os.stat(path)
        if status.st_size != entry["size"]:
            return False
        return bool(status.st_mtime_ns == entry["mtime_ns"] or hash_file(path) == entry["sha256"])
    except OSError:
        return False


def hash_file(path: str) -> str:
    """SHA-256 of a file, in hexadecimal."""
    import hashlib  # not in the usual case

    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def _has_library(home: str) -> bool:
    place, start = os.path.split(os.path.join(home, LIBRARY))
    try:
        return any(name.startswith(start) for name in os.listdir(place))
    except OSError:
        return False


def see_sources_alone(home: str) -> None:
    """From now on import modules of our packages from their sources, whatever is built beside them now or later."""
    ours = tuple(os.path.join(home, name) for name in PACKAGES)
    open_finder = FileFinder.path_hook((SourceFileLoader, SOURCE_SUFFIXES))

    def find_sources(path: str) -> Any:
        place = os.path.abspath(path)
        if place not in ours and not place.startswith(tuple(f"{top}{os.sep}" for top in ours)):
            raise ImportError("not one of our packages", path=path)
        return open_finder(path)

    sys.path_hooks.insert(0, find_sources)
    for path in list(sys.path_importer_cache):  # finders from before, that of this package at least
        if path.startswith(ours):
            del sys.path_importer_cache[path]


CURRENT = find_build(HOME, os.environ.get(CHOICE, ""))
if not CURRENT.compiled:
    see_sources_alone(HOME)
