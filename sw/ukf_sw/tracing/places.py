"""Where in the user's source something happens: file, line, expression."""

import ast
import inspect
import linecache
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import takewhile
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np

__all__ = ["HERE", "Place", "calling_module", "calls", "is_foreign", "place_below"]

#: Folder of what traces.
HERE = str(Path(__file__).parent)
#: Files of NumPy; before version 1.25 it also has frames of no file.
_NUMPY = str(Path(np.__file__).parent), "<__array_function__"
_STANDARD = str(Path(ast.__file__).parent)
_INSTALLED = {"site-packages", "dist-packages"}
#: Characters of source that a message shows at most.
_LONGEST = 80


@dataclass(frozen=True)
class Place:
    """A place in the user's source.

    Parameters
    ----------
    file, line
        Where it is.
    expression
        What stands there; nothing if the source cannot be read.
    syntax
        What the expression is and what it stands in, from the inside; all that is on the line if
        it is not exact.
    exact
        Whether the column is known: Python tells it from 3.11 on.
    """

    file: str
    line: int
    expression: str
    syntax: tuple[ast.AST, ...] = ()
    exact: bool = False


def _package(frame: FrameType) -> str:
    """Name of the package of a frame."""
    return str(frame.f_globals.get("__name__", "")).partition(".")[0]


def is_foreign(file: str) -> bool:
    """Whether a file belongs to Python or to what is installed."""
    return bool(_INSTALLED & set(Path(file).parts)) or file.startswith(
        (_STANDARD, "<frozen", *_NUMPY)
    )


def _frame(levels: int) -> FrameType | None:
    """Give the frame so many levels above the caller of what calls this."""
    frame = inspect.currentframe()
    for _ in range(levels + 2):
        frame = frame and frame.f_back
    return frame


def calling_module(levels: int) -> tuple[str, str]:
    """File and package of the frame so many levels above the caller."""
    frame = _frame(levels)
    return ("", "") if frame is None else (frame.f_code.co_filename, _package(frame))


def calls(name: str, levels: int) -> bool:
    """Whether the frame so many levels above the caller calls a function of this name itself.

    What is written in C has no frame: of all that it calls, who called it seems to be the caller.
    """
    frame = _frame(levels)
    if frame is None:
        return False
    place = _place(_Spot(frame, frame.f_lineno, frame.f_lasti))
    syntax = place.syntax
    if not (place.exact and syntax):
        return name in frame.f_code.co_names
    known = frame.f_globals | frame.f_locals
    named = {getattr(node, "attr", "") for node in ast.walk(syntax[0])}
    for node in ast.walk(syntax[0]):
        if isinstance(node, ast.Name):  # it may have another name here
            named |= {node.id, str(getattr(known.get(node.id), "__name__", ""))}
    return name in named


@dataclass(frozen=True)
class _Spot:
    """A frame, with the line and the instruction where it is, or was."""

    frame: FrameType
    line: int
    instruction: int

    @property
    def file(self) -> str:
        """File of its source."""
        return self.frame.f_code.co_filename


def _under_way() -> Iterator[_Spot]:
    """Frames that are under way, from the inside."""
    frame = inspect.currentframe()
    while frame is not None:
        yield _Spot(frame, frame.f_lineno, frame.f_lasti)
        frame = frame.f_back


def _passed(error: BaseException) -> list[_Spot]:
    """Frames that an error has passed, from the inside."""
    found: list[_Spot] = []
    step = error.__traceback__
    while step is not None:
        found.insert(0, _Spot(step.tb_frame, step.tb_lineno, step.tb_lasti))
        step = step.tb_next
    return found


def place_below(entry: CodeType, error: BaseException | None = None) -> Place | None:
    """Find the innermost place in the user's own source.

    Parameters
    ----------
    entry
        Code that has called the model.
    error
        What was raised there; None: where it is now.
    """
    inside = takewhile(
        lambda spot: spot.frame.f_code is not entry,
        _under_way() if error is None else _passed(error),
    )
    spots = [spot for spot in inside if not spot.file.startswith((HERE, *_NUMPY))]
    if not spots:
        return None
    package = _package(spots[-1].frame)
    own = [
        spot for spot in spots if _package(spot.frame) == package or not is_foreign(spot.file)
    ]  # fmt: skip
    return _place(own[0])


@lru_cache(maxsize=8)
def _tree(source: str) -> ast.AST | None:
    try:
        return ast.parse(source)
    except SyntaxError:
        return None


def _span(spot: _Spot) -> tuple[int, int, int, int] | None:
    """Lines and columns of what a frame does; None before Python 3.11."""
    positions = getattr(spot.frame.f_code, "co_positions", None)
    if positions is None:
        return None
    found: Any = list(positions())[spot.instruction // 2]
    return None if None in found else (found[0], found[2], found[1], found[3])


def _place(spot: _Spot) -> Place:
    file, line = spot.file, spot.line
    lines = linecache.getlines(file, spot.frame.f_globals)
    tree = _tree("".join(lines)) if lines else None
    if tree is None:
        return Place(file, line, "".join(lines[line - 1 : line]).strip())
    span = _span(spot)
    if span is None:
        return Place(file, line, _shown(lines[line - 1]), tuple(_on_line(tree, line)))
    syntax = _standing(_enclosing(tree, span))
    text = ast.get_source_segment("".join(lines), syntax[0]) if syntax else None
    return Place(file, line, _shown(text or lines[line - 1]), tuple(syntax), exact=True)


def _shown(text: str) -> str:
    """Give a piece of source in a line that is not too long."""
    line = " ".join(text.split())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 3] + "..."


def _contains(node: Any, span: tuple[int, int, int, int]) -> bool:
    first, left, last, right = span
    begin, end = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
    return begin <= (first, left) and (last, right) <= end


def _enclosing(tree: ast.AST, span: tuple[int, int, int, int]) -> list[ast.AST]:
    """Give what contains a span of lines and columns, from the inside."""
    for child in ast.iter_child_nodes(tree):
        if not hasattr(child, "lineno"):
            inside = _enclosing(child, span)
            if inside:
                return [*inside, child]
        elif _contains(child, span):
            return [*_enclosing(child, span), child]
    return []


def _standing(path: list[ast.AST]) -> list[ast.AST]:
    """Leave out what is around the function, and branches of which it is not the condition."""
    found: list[ast.AST] = []
    inner: ast.AST | None = None
    for node in path:
        if isinstance(node, ast.FunctionDef | ast.Lambda | ast.ClassDef):
            break
        decides = inner in node.ifs if isinstance(node, ast.comprehension) else True
        if inner is None or (decides and getattr(node, "test", inner) is inner):
            found.append(node)
        inner = node
    return found


def _on_line(tree: ast.AST, line: int) -> list[ast.AST]:
    """Give what stands on a line, from the inside: as good as it gets without columns."""
    found: list[ast.AST] = []
    for node in ast.walk(tree):
        place: Any = getattr(node, "test", node)
        if isinstance(node, ast.FunctionDef | ast.Lambda | ast.ClassDef):
            continue
        if hasattr(place, "lineno") and place.lineno <= line <= place.end_lineno:
            found.insert(0, node)
    return found
