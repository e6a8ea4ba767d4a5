"""The directory of a run: one run has it, and what is in it stays."""

from __future__ import annotations

import contextlib
import multiprocessing
from pathlib import Path

import pytest

from bus.errors import RecordError, UsageError
from tools.log.mcap_writer import McapWriter
from tools.run.directory import keep_words, own_directory


def test_a_claimed_directory_is_refused_to_the_next(tmp_path: Path) -> None:
    """The second claim fails while the first lasts, and not after it; nothing of the claim stays."""
    with own_directory(tmp_path / "x", "name") as first:
        assert first == tmp_path / "x"
        with pytest.raises(UsageError, match="another run has it"), own_directory(tmp_path / "x", "name"):
            pass
        assert [path.name for path in first.iterdir()] == ["run.claim"]
    assert not list(first.iterdir())
    with own_directory(tmp_path / "x", "name"):
        pass


@pytest.mark.parametrize("taken", ["run.mcap", "run.png"])
def test_a_directory_that_holds_a_run_is_refused(taken: str, tmp_path: Path) -> None:
    """A log or a picture, even a dangling link of that name, is in the way; the user's own files are not."""
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / taken).symlink_to(tmp_path / "nowhere")
    with pytest.raises(UsageError, match=f"there is a {taken} in it"), own_directory(tmp_path, "name"):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["notes.txt", taken])
    (tmp_path / taken).unlink()
    with own_directory(tmp_path, "name"):
        pass


def claim_default(queue: multiprocessing.Queue[str]) -> None:
    with own_directory(None, "same") as directory:
        queue.put(str(directory))


def test_runs_started_together_get_directories_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """40 processes ask for the default directory of one name within a moment: 40 directories."""
    monkeypatch.chdir(tmp_path)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    processes = [context.Process(target=claim_default, args=(queue,)) for _ in range(40)]
    for process in processes:
        process.start()
    names = {queue.get(timeout=20) for _ in processes}
    for process in processes:
        process.join()
    assert len(names) == 40
    assert names == {str(path.relative_to(tmp_path)) for path in (tmp_path / "runs").iterdir()}


@pytest.mark.parametrize("name", ["../../x", "a/b", "n" * 300, "nul\0", "λ" * 100])
def test_a_name_that_cannot_be_a_directory_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is made outside runs/, and the message is one short line."""
    (tmp_path / "a").mkdir()
    monkeypatch.chdir(tmp_path / "a")
    with pytest.raises(UsageError, match="cannot name a directory") as caught, own_directory(None, name):
        pass
    assert len(str(caught.value)) < 250
    assert "\0" not in str(caught.value)
    assert [path.name for path in tmp_path.rglob("*")] == ["a"]


def test_a_directory_that_cannot_be_made_or_written_is_named(tmp_path: Path) -> None:
    """A file, a dangling link, a name that is too long or has a NUL: words, and never another kind of error."""
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for wanted in ("file", "file/out", "link", "n" * 300, "nul\0"):
        with pytest.raises(UsageError, match="--out"), own_directory(tmp_path / wanted, "name"):
            pass


def test_words_are_kept_under_a_name_that_is_free(tmp_path: Path) -> None:
    """NAME.err, NAME-2.err, NAME-3.err: the one that was there is as it was."""
    (tmp_path / "plant.err").write_text("mine")
    kept = [keep_words(tmp_path, "plant", text) for text in (b"one", b"two")]
    assert [path and path.name for path in kept] == ["plant-2.err", "plant-3.err"]
    assert [(tmp_path / name).read_text() for name in ("plant.err", "plant-2.err", "plant-3.err")] == [
        "mine", "one", "two",
    ]  # fmt: skip
    assert keep_words(tmp_path / "nowhere", "plant", b"x") is None


def test_a_body_that_fails_gives_the_directory_up(tmp_path: Path) -> None:
    """The claim goes with an exception too."""
    with contextlib.suppress(RuntimeError), own_directory(tmp_path, "name"):
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_a_log_is_made_new(tmp_path: Path) -> None:
    """The writer refuses a file that is there, and a dangling link; both stay as they are. A device has nothing to lose."""
    (tmp_path / "old.mcap").write_text("mine")
    (tmp_path / "link.mcap").symlink_to(tmp_path / "nowhere")
    for name in ("old.mcap", "link.mcap"):
        with pytest.raises(RecordError, match="there is a file of that name"):
            McapWriter(tmp_path / name)
    assert (tmp_path / "old.mcap").read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()
    McapWriter("/dev/null").close()
