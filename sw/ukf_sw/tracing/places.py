"""Where in the user's source something happens: file, line, expression."""

import ast
import inspect
import linecache
import sysconfig
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np

__all__ = ["HERE", "Place", "calling_module", "is_foreign", "place_below"]

#: Folder of what traces.
HERE = str(Path(__file__).parent)
_NUMPY = str(Path(np.__file__).parent)
_STANDARD = sysconfig.get_path("stdlib")
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
    return bool(_INSTALLED & set(Path(file).parts)) or file.startswith((_STANDARD, "<frozen"))


def calling_module(levels: int) -> tuple[str, str]:
    """File and package of the frame so many levels above the caller."""
    frame = inspect.currentframe()
    for _ in range(levels + 1):
        frame = frame and frame.f_back
    return ("", "") if frame is None else (frame.f_code.co_filename, _package(frame))


def _frames(entry: CodeType) -> Iterator[FrameType]:
    """Frames of the user below that of `entry`, from the inside."""
    frame = inspect.currentframe()
    while frame is not None and frame.f_code is not entry:
        if not frame.f_code.co_filename.startswith((HERE, _NUMPY)):
            yield frame
        frame = frame.f_back


def place_below(entry: CodeType) -> Place | None:
    """Find the innermost place in the user's own source.

    Parameters
    ----------
    entry
        Code that has called the model.
    """
    frames = list(_frames(entry))
    if not frames:
        return None
    package = _package(frames[-1])
    own = [
        frame for frame in frames
        if _package(frame) == package or not is_foreign(frame.f_code.co_filename)
    ]  # fmt: skip
    return _place(own[0])


@lru_cache(maxsize=8)
def _tree(source: str) -> ast.AST | None:
    try:
        return ast.parse(source)
    except SyntaxError:
        return None


def _span(frame: FrameType) -> tuple[int, int, int, int] | None:
    """Lines and columns of what a frame is about to do; None before Python 3.11."""
    positions = getattr(frame.f_code, "co_positions", None)
    if positions is None:
        return None
    found: Any = list(positions())[frame.f_lasti // 2]
    return None if None in found else (found[0], found[2], found[1], found[3])


def _place(frame: FrameType) -> Place:
    file, line = frame.f_code.co_filename, frame.f_lineno
    lines = linecache.getlines(file, frame.f_globals)
    tree = _tree("".join(lines)) if lines else None
    if tree is None:
        return Place(file, line, "".join(lines[line - 1 : line]).strip())
    span = _span(frame)
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
