"""Pages with code that is executed: what a page says is printed is what was printed.

In the Markdown of such a page,

- a block ``python`` is executed, in the order of the page, all in one namespace;
- a block ``python title="FILE"`` is appended to that file instead, which others import;
- a block ``sh`` is executed by the shell;
- a block ``text`` right after one of them holds what it printed.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ukf_docs import DOCS

__all__ = ["PAGES", "SLOW", "refresh"]

#: Pages with executed code.
PAGES = tuple(
    DOCS / name for name in ("own-model.md", "sensors.md", "from-filterpy.md", "models-on-core.md")
)

#: What blocks have that take long: they compile a core, or make many.
SLOW = re.compile(r"\bcosimulate\b|\bukf (?:cosim|sweep|package|c-loop)\b")

#: A block that is executed, and its output, if the page shows it.
BLOCK = re.compile(
    r"^```(?P<kind>python|sh|c)(?: title=\"(?P<file>[\w.]+)\")?\n(?P<code>.*?)^```\n"
    r"(?P<output>\n```text\n.*?^```\n)?",
    re.MULTILINE | re.DOTALL,
)


def refresh(text: str, *, slow: bool = True, cache: Path | None = None) -> str:
    """Execute the code of a page, in a folder of its own, and replace what it printed.

    Parameters
    ----------
    text
        Markdown of the page.
    slow
        Whether to execute blocks that have what is in :data:`SLOW`; otherwise their output stays.
    cache
        Folder of compiled cores; None compiles them again.

    Returns
    -------
    str
        The page with the output of today.

    Raises
    ------
    ValueError
        If a block prints something and the page has no place for it.
    Exception
        Whatever the code raises, with a note that says in which block.
    """
    namespace: dict[str, Any] = {}

    def execute(block: re.Match[str]) -> str:
        code, output = block["code"], block["output"]
        if block["file"]:
            with Path(block["file"]).open("a", encoding="utf-8") as file:
                file.write(code)
            sys.modules.pop(Path(block["file"]).stem, None)
            return block[0]
        if block["kind"] == "c" or (SLOW.search(code) and not slow):
            return block[0]
        try:
            printed = _run(block["kind"], code, namespace)
        except Exception as error:
            error.add_note(f"in the block that begins with {code.splitlines()[0]!r}")
            raise
        if output is None:
            if printed and block["kind"] == "python":
                raise ValueError(f"A block text must follow the block that prints {printed!r}")
            return block[0]
        shown = f"\n```text\n{printed}```\n"
        return block[0][: len(block[0]) - len(output)] + shown

    with _folder(cache):
        return BLOCK.sub(execute, text)


def _run(kind: str, code: str, namespace: dict[str, Any]) -> str:
    """Execute a block; gives what it printed."""
    if kind == "sh":
        programs = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
        done = subprocess.run(
            ["sh", "-e", "-c", code], env=os.environ | {"PATH": programs, "COLUMNS": "100"},
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        return done.stdout
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(code, "<page>", "exec"), namespace)  # the purpose of this module
    return printed.getvalue()


@contextlib.contextmanager
def _folder(cache: Path | None) -> Iterator[None]:
    """Work in a new folder, from which modules are imported, and leave no trace of them."""
    before, modules = Path.cwd(), set(sys.modules)
    with tempfile.TemporaryDirectory(prefix="ukf-page-") as folder:
        os.chdir(folder)
        sys.path.insert(0, folder)
        try:
            if cache is not None:
                cache.mkdir(parents=True, exist_ok=True)
                Path("build").mkdir()
                Path("build/cosim").symlink_to(cache.resolve())
            yield
        finally:
            os.chdir(before)
            sys.path.remove(folder)
            for name in set(sys.modules) - modules:
                file = getattr(sys.modules[name], "__file__", None)
                if file and Path(file).is_relative_to(folder):
                    del sys.modules[name]
