"""The revision in a log is ours or none: told in repositories of the tests' own making."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.run import provenance

AUTHOR = {"GIT_AUTHOR_NAME": "a", "GIT_AUTHOR_EMAIL": "a@example.org"}
COMMITTER = {"GIT_COMMITTER_NAME": "a", "GIT_COMMITTER_EMAIL": "a@example.org"}


def git(place: Path, *words: str) -> str:
    """What git prints there."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    done = subprocess.run(
        ["git", "-C", str(place), *words],
        capture_output=True, text=True, check=True, env=environment | AUTHOR | COMMITTER,
    )  # fmt: skip
    return done.stdout.strip()


def make_repository(place: Path) -> str:
    """A repository with one commit, its abbreviated hash."""
    place.mkdir(parents=True, exist_ok=True)
    git(place, "init", "-q")
    git(place, "commit", "-q", "--allow-empty", "-m", "own")
    return git(place, "rev-parse", "--short", "HEAD")


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A tree that looks like ours, which the code under test is made to believe it runs from."""
    home = tmp_path / "own" / "lib" / "hilsat"
    (home / "tools" / "run").mkdir(parents=True)
    (home / "tools" / "cli.py").write_text("")
    monkeypatch.setattr(provenance, "__file__", str(home / "tools" / "run" / "provenance.py"))
    return home


def test_a_copy_inside_another_repository_has_no_revision(tree: Path, tmp_path: Path) -> None:
    """Installed below somebody's own project, tracked there or not: empty."""
    make_repository(tmp_path / "own")
    assert provenance.read_revision() == ""
    git(tmp_path / "own", "add", "-A")
    git(tmp_path / "own", "commit", "-q", "-m", "vendored")
    assert provenance.read_revision() == ""


def test_a_repository_named_by_the_environment_is_not_asked(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GIT_DIR and GIT_WORK_TREE, as a hook of another repository has them, change nothing."""
    make_repository(tmp_path / "other")
    (tmp_path / "other" / "tools").mkdir()
    (tmp_path / "other" / "tools" / "cli.py").write_text("")
    git(tmp_path / "other", "add", "-A")
    git(tmp_path / "other", "commit", "-q", "-m", "a file of the same name")
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "other" / ".git"))
    monkeypatch.setenv("GIT_WORK_TREE", str(tree))
    assert provenance.read_revision() == ""


def test_a_checkout_of_its_own_has_one(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tracked: the commit, +dirty with changes. A repository there that does not track us has none."""
    make_repository(tree)
    assert provenance.read_revision() == ""
    git(tree, "add", "-A")
    git(tree, "commit", "-q", "-m", "ours")
    revision = git(tree, "rev-parse", "--short", "HEAD")
    assert provenance.read_revision() == revision
    (tree / "tools" / "cli.py").write_text("changed")
    assert provenance.read_revision() == f"{revision}+dirty"
    monkeypatch.setenv("PATH", "")
    assert provenance.read_revision() == ""


def test_the_second_run_of_a_process_asks_git_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that a process has loaded changes with the tree, so every log of it names one program."""
    resolved = load_scenario(find_scenario("nominal"))
    first = provenance.describe_run(resolved, "in process")
    monkeypatch.setattr(provenance, "_ask_git", lambda *words: pytest.fail("git was asked again"))
    second = provenance.describe_run(resolved, "in process")
    program = ("host", "platform", "python", "versions", "git_rev", "build")
    assert [second[key] for key in program] == [first[key] for key in program]
    assert list(first)[-6:] == list(program)
