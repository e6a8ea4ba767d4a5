"""Pictures of a page as SVG text: drawn by matplotlib, in the page's own colours.

Fonts are the reader's, whatever matplotlib draws black takes the colour of the text around it, and lines take the colours
that the page's style gives them: so the same picture is right on light, dark and printed pages.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any, Final

SIZE: Final = (4.8, 2.1)  # inches: the letters are to be read on a telephone too
Margins = tuple[float, float, float, float]
LINE, BOUND, FAULT, WINDOW = "#2563a8", "#b3261e", "#b45f06", "#8888aa"
PAGE_COLOURS: Final = {LINE: "--chart-line", BOUND: "--chart-bound", FAULT: "--chart-fault", WINDOW: "--chart-window"}
STYLE: Final[dict[Any, Any]] = {
    "svg.fonttype": "none", "svg.hashsalt": "hilsat", "font.size": 8.5, "axes.spines.top": False,
    "axes.spines.right": False, "text.parse_math": False, "axes.formatter.use_mathtext": False,
}  # fmt: skip


def paint(
    draw: Callable[[Any], None],
    title: str,
    height: float = SIZE[1],
    left: float = 0.62,
    *,
    width: float = SIZE[0],
    margins: Margins | None = None,
) -> str:
    """Return the SVG of one panel; `title` is what a screen reader says of it. Places in inches, `left` for the labels.

    margins : left, right, bottom, top of the panel as shares of the picture, in place of `left`
    Neither pyplot nor a layout engine: they take longer than the drawing.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    x0, x1, y0, y1 = margins or (left / width, 1.0 - 0.12 / width, 0.42 / height, 1.0 - 0.26 / height)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        FigureCanvasSVG(figure)
        axis = figure.add_axes((x0, y0, x1 - x0, y1 - y0))
        draw(axis)
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return _adopt(text.getvalue(), title)


def _adopt(svg: str, title: str) -> str:
    """Make a file's SVG part of a page: no prolog, the page's colours and fonts, a name for who cannot see it."""
    body = svg[svg.index("<svg") :]
    head_end = body.index(">")
    view = re.search(r'viewBox="[^"]*"', body[:head_end])
    body = body[head_end + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->\s*", "", body, flags=re.DOTALL)
    body = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font: \1 sans-serif", body)
    body = body.replace("#000000", "currentColor").replace("stroke: black", "stroke: currentColor")
    for colour, name in PAGE_COLOURS.items():
        body = body.replace(colour, f"var({name})")
    body = re.sub(r"<text(?=[ >])", '<text fill="currentColor"', body)
    label = title.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {view[0] if view else ""} role="img" aria-label="{label}">'
    return f"{head}<title>{label}</title>{body}"


def number_ids(svg: str, number: int) -> str:
    """The picture with ids that no other picture of the page has."""
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>c{number}-", svg)


def use_log_scale(axis: Any) -> None:
    """A logarithmic y axis with plain labels: a formula for each takes a tenth of a second."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_yscale("log")
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
