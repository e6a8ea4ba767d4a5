"""Pictures of a page as SVG text: drawn by matplotlib, with the page's own colour for text and axes.

Fonts are the reader's, and whatever matplotlib draws black takes the colour of the text around it: so the same picture is
right on light, dark and printed pages.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any, Final

SIZE: Final = (5.8, 2.3)  # inches
Margins = tuple[float, float, float, float]
LINE, BOUND, FAULT, WINDOW = "#2563a8", "#b3261e", "#b45f06", "#8888aa"


def paint(
    draw: Callable[[Any], None],
    title: str,
    height: float = SIZE[1],
    width: float = SIZE[0],
    margins: Margins | None = None,
) -> str:
    """Return the SVG of one panel; `title` is what a screen reader says of it.

    margins : left, right, bottom, top of the panel as shares of the picture; None: measured, which takes half of the time
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure  # and not pyplot, which takes a second to import and is for windows

    settings: dict[Any, Any] = {
        "svg.fonttype": "none",
        "svg.hashsalt": "hilsat",
        "font.size": 9.0,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
    with rc_context(settings):
        figure = Figure(figsize=(width, height), layout=None if margins else "constrained")
        FigureCanvasSVG(figure)
        if margins:
            left, right, bottom, top = margins
            figure.subplots_adjust(left=left, right=right, bottom=bottom, top=top)
        draw(figure.subplots())
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return _adopt(text.getvalue(), title)


def _adopt(svg: str, title: str) -> str:
    """Make a file's SVG part of a page: no prolog, the page's colour and fonts, a name for who cannot see it."""
    body = svg[svg.index("<svg") :]
    head_end = body.index(">")
    view = re.search(r'viewBox="[^"]*"', body[:head_end])
    body = body[head_end + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font: \1 sans-serif", body)
    body = body.replace("#000000", "currentColor").replace("stroke: black", "stroke: currentColor")
    body = re.sub(r"<text ", '<text fill="currentColor" ', body)
    label = title.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {view[0] if view else ""} role="img" aria-label="{label}">'
    return f"{head}<title>{label}</title>{body}"
