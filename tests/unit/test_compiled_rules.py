"""The modules that are compiled keep clear of what mypyc makes something else of: the rules, and our list under them."""

from __future__ import annotations

import pytest

from tools.compiled.project import HOME, list_modules
from tools.compiled.rules import check_file, check_source

BAD = {
    "xs = [x, *(x := f())]": "x := beside another use of x",
    "xs = {'a': (x := f()), 'b': x}": "x := beside",
    "f((x := g()), x)": "x := beside",
    "rest = view[f.write(view):]": "in the bounds of a slice",
    "rest = self.view[: (n := f())]": "in the bounds of a slice",
    "view[f(view):] = rest": "in the bounds of a slice",
    "X: Final = (1.0, 2.0)": "Final on a tuple of floats",
    "X: Final = ((1, 2), (3, -4.0))": "Final on a tuple of floats",
    "X: typing.Final = (A, 1)": "Final on a tuple of floats",
    "X: Final[Vec3] = make()": "Final on a tuple of floats",
    "X: Final[tuple[float, int]] = make()": "Final on a tuple of floats",
    "class C:\n    k: Annotated[float, Gt(0)] = 1.0": "C has Annotated fields",
    "if __name__ == '__main__':\n    main()": "python -m",
}
GOOD = [
    "if (x := f()) and x > 2:\n    g(x)",
    "xs = [y for x in xs if (y := f(x))]",
    "f((x := g()), y)",
    "at = f.write(view)\nrest = view[at:]",
    "rest = view[len(view) - 1 :]",
    "rest = view[f(view)]",
    "X: Final = 1.0",
    "X: Final[float] = make()",
    "X: Final = (1, -2, 'a')",
    "X: Vec3 = (1.0, 2.0, 3.0)",
    "def f(x: Annotated[float, 'm']) -> None: ...",
]


@pytest.mark.parametrize(("text", "words"), BAD.items())
def test_a_trap_is_found(text: str, words: str) -> None:
    """With the line it stands on, once."""
    found = check_source("bus/x.py", f"import x\n{text}\n")
    assert len(found) == 1, found
    assert found[0].startswith("bus/x.py:")
    assert words in found[0]


@pytest.mark.parametrize("text", GOOD)
def test_what_is_no_trap_passes(text: str) -> None:
    """Near to one, and computed as Python does."""
    assert check_source("bus/x.py", f"{text}\n") == []


@pytest.mark.parametrize(
    "name", ["bus/build.py", "fsw/settings.py", "fsw/config.py", "fsw/__main__.py", "bus/__init__.py"]
)
def test_some_modules_are_never_compiled(name: str) -> None:
    """Those that choose the build, are started by name, or are read by their annotations."""
    assert f"{name}:1: must not be compiled: its kind of module is run as it is" in check_file(HOME, name)


@pytest.mark.parametrize("name", list_modules(HOME))
def test_our_modules_keep_the_rules(name: str) -> None:
    """Each module of the list in pyproject.toml."""
    assert check_file(HOME, name) == []
