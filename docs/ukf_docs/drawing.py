"""A drawing of boxes and arrows, as SVG that needs no font and no script of its own."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

__all__ = ["DIM", "PAPER", "Box", "Drawing", "Point"]

Point = tuple[float, float]

#: Colours. The paper is white in dark pages as well.
PAPER, LINE, INK, DIM = "#ffffff", "#5b6b7c", "#1b1f24", "#5b6b7c"
FONTS = "system-ui, Roboto, Helvetica, Arial, sans-serif"
#: Head of an arrow.
HEAD = (
    '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" '
    'markerUnits="userSpaceOnUse" orient="auto-start-reverse">'
    f'<path d="M0,0 L8,4 L0,8 z" fill="{LINE}"/></marker>'
)
#: Height of a line of text as a part of its size.
LEADING = 1.3


@dataclass(frozen=True)
class Box:
    """A rectangle, for what is joined to it.

    Parameters
    ----------
    x, y
        Upper left corner, in pixels.
    width, height
        Its size.
    """

    x: float
    y: float
    width: float
    height: float

    def left(self, part: float = 0.5) -> Point:
        """Point of the left side, so far down as a part of the height."""
        return self.x, self.y + part * self.height

    def right(self, part: float = 0.5) -> Point:
        """Point of the right side, so far down as a part of the height."""
        return self.x + self.width, self.y + part * self.height

    def top(self, part: float = 0.5) -> Point:
        """Point of the upper side, so far right as a part of the width."""
        return self.x + part * self.width, self.y

    def bottom(self, part: float = 0.5) -> Point:
        """Point of the lower side, so far right as a part of the width."""
        return self.x + part * self.width, self.y + self.height


class Drawing:
    """A drawing that grows by what is put into it.

    Parameters
    ----------
    title
        What it shows, for those who do not see it.
    width, height
        Its size, in pixels.
    """

    def __init__(self, title: str, width: int, height: int) -> None:
        self._title, self._size = title, (width, height)
        self._elements: list[str] = []

    def box(
        self, x: float, y: float, width: float, height: float, *lines: str,
        fill: str = PAPER, stroke: str = LINE, size: float = 13, radius: float = 5,
        heading: bool = False,
    ) -> Box:  # fmt: skip
        """Draw a rectangle with lines of text in it; gives the rectangle.

        Parameters
        ----------
        x, y, width, height
            Where.
        lines
            Text in its middle, or along its upper side; what is between asterisks is bold.
        fill, stroke, size, radius
            Colours, size of the text, radius of the corners.
        heading
            Whether the text stands along the upper side, as over a group of boxes.
        """
        self._elements.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="{radius:g}" '
            f'fill="{fill}" stroke="{stroke}"/>'
        )
        middle = y + size if heading else y + height / 2 - (len(lines) - 1) * size * 0.65
        self.text(x + width / 2, middle, *lines, size=size)
        return Box(x, y, width, height)

    def bars(self, bars: Iterable[tuple[float, float, float, float]], fill: str) -> None:
        """Draw rectangles of one colour, each as x, y, width and height, as one shape."""
        path = "".join(f"M{x:.4g},{y:.4g}h{w:.3g}v{h:.3g}h-{w:.3g}z" for x, y, w, h in bars)
        self._elements.append(f'<path d="{path}" fill="{fill}"/>')

    def text(
        self, x: float, y: float, *lines: str, size: float = 12, anchor: str = "middle",
        fill: str = INK,
    ) -> None:  # fmt: skip
        """Write lines of text, the middle of the first at y; what is between asterisks is bold."""
        for number, line in enumerate(lines):
            baseline = y + size * (0.35 + LEADING * number)
            bold = re.sub(r"\*(.+?)\*", r'<tspan font-weight="bold">\1</tspan>', escape(line))
            self._elements.append(
                f'<text x="{x:g}" y="{baseline:.1f}" font-size="{size:g}" text-anchor="{anchor}" '
                f'fill="{fill}">{bold}</text>'
            )

    def arrow(
        self, *points: Point, label: Sequence[str] = (), at: Point | None = None,
        anchor: str = "middle", both: bool = False,
    ) -> None:  # fmt: skip
        """Draw an arrow along points.

        Parameters
        ----------
        points
            Where it goes.
        label, at, anchor
            Lines beside it, the middle of the first one, which end of the lines that is;
            without a place they stand above the middle of the first stretch.
        both
            Whether it has a head at either end.
        """
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        start = ' marker-start="url(#head)"' if both else ""
        self._elements.append(
            f'<polyline points="{path}" fill="none" stroke="{LINE}" stroke-width="1.5"{start} '
            'marker-end="url(#head)"/>'
        )
        if at is None:
            (x, y), (to_x, to_y) = points[:2]
            at = (x + to_x) / 2, (y + to_y) / 2 - 9 - 14 * (len(label) - 1)
        self.text(*at, *label, fill=DIM, anchor=anchor)

    def svg(self) -> str:
        """Give the drawing as text."""
        width, height = self._size
        frame = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" {frame} role="img" font-family="{FONTS}">',
            f"<title>{escape(self._title)}</title>",
            HEAD,
            f'<rect width="{width}" height="{height}" rx="6" fill="{PAPER}"/>',
            *self._elements,
            "</svg>",
        ]
        return "\n".join(lines) + "\n"
