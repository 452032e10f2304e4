"""Equations: the part of TeX that the pages use, as MathML, which browsers set by themselves.

GitHub sets a block ``math`` as well, so the pages hold TeX and nothing else.
"""

import re
from collections.abc import Iterator
from html import escape
from typing import Any

__all__ = ["fence", "mathml"]

#: Signs of the commands that take no argument, by the element that they become.
SIGNS = {
    "mi": {
        "alpha": "α", "beta": "β", "chi": "χ", "delta": "δ", "omega": "ω", "psi": "ψ", "sigma": "σ",
        "theta": "θ", "infty": "∞", "top": "⊤", "ldots": "…", "cos": "cos", "sin": "sin",
    },
    "mo": {
        "cdot": "⋅", "times": "×", "pm": "±", "leftarrow": "←", "le": "≤", "ge": "≥", "ne": "≠",
        "in": "∈", "sum": "∑", "otimes": "⊗", "approx": "≈",
    },
}  # fmt: skip
#: Widths of spaces.
SPACES = {",": "0.17em", ";": "0.28em", "quad": "1em", "qquad": "2em"}
#: What stands above an argument.
ACCENTS = {"bar": "¯", "hat": "^"}
#: Blocks of rows and columns: their fences, and how their columns stand.
BLOCKS = {"aligned": ("", "", ("right", "left")), "bmatrix": ("[", "]", ("center",))}

PRIME = '<mo lspace="0" rspace="0">′</mo>'
#: Spaces at the ends of a text are dropped, but not these.
NO_BREAK = "\N{NO-BREAK SPACE}"

#: A command, with the words in braces of those that take some; a letter, a number, a sign.
TOKEN = re.compile(
    r"\\(?P<worded>text|begin|end)\{(?P<words>[^{}]*)\}"
    r"|\\(?P<command>[A-Za-z]+|.)|(?P<letter>[A-Za-z])|(?P<number>\d+(?:\.\d+)?)|(?P<sign>\S)"
)


def fence(source: str, *_: Any, **__: Any) -> str:
    """Set a block ``math``: formatter of SuperFences."""
    return f'<div class="equation">{mathml(source)}</div>'


def mathml(source: str) -> str:
    """Turn an equation in TeX, without dollar signs, into MathML.

    Raises
    ------
    ValueError
        If a command or block is not known, if a brace or block is not closed, or if something has
        two scripts in one place.
    """
    return _Setter(source).equation()


class _Setter:
    """Takes the tokens of an equation one after the other."""

    def __init__(self, source: str) -> None:
        self._source = source.strip()
        self._tokens: Iterator[re.Match[str]] = TOKEN.finditer(self._source)
        self._token = next(self._tokens, None)

    def equation(self) -> str:
        """Set the whole."""
        row = ""
        while self._token is not None:
            row += self._scripted()
        return f'<math display="block">{row}</math>'

    def _take(self) -> re.Match[str]:
        """Take a token."""
        taken, self._token = self._token, next(self._tokens, None)
        if taken is None:
            raise ValueError(f"equation must be complete, not {self._source!r}")
        return taken

    def _sees(self, text: str) -> bool:
        """Tell whether the next token is this one."""
        return self._token is not None and self._token[0] == text

    def _scripted(self) -> str:
        """Take a piece, and what stands below and above it."""
        wide = self._sees(r"\sum")
        base, below, above = self._piece(), "", ""
        while self._token is not None and self._token[0] in "_^'":
            mark = self._take()[0]
            script = PRIME if mark == "'" else self._piece()
            if below if mark == "_" else above:
                raise ValueError(f"equation must have one script {mark}, not {self._source!r}")
            if mark == "_":
                below = script
            else:
                above = script
        if not below + above:
            return base
        names = ("under", "over") if wide else ("sub", "sup")
        tag = "m" + names[0] * bool(below) + names[1] * bool(above)
        return f"<{tag}>{base}{below}{above}</{tag}>"

    def _piece(self) -> str:
        """Take a token with its arguments."""
        token = self._take()
        if token[0] == "{":
            return self._group()
        if token[0] in "}&":
            raise ValueError(f"equation must have its {token[0]} in a block, not {self._source!r}")
        if token["worded"]:
            return self._worded(token["worded"], token["words"])
        if token["command"]:
            return self._command(token["command"])
        if token["sign"]:
            fixed = ' stretchy="false"' if token[0] in "()[]|" else ""
            return f"<mo{fixed}>{escape(token[0].replace('-', '−'))}</mo>"
        return f"<mi>{token[0]}</mi>" if token["letter"] else f"<mn>{token[0]}</mn>"

    def _group(self) -> str:
        """Take what stands in braces."""
        row = ""
        while not self._sees("}"):
            row += self._scripted()
        self._take()
        return f"<mrow>{row}</mrow>"

    def _command(self, name: str) -> str:
        """Set a command."""
        for element, signs in SIGNS.items():
            if name in signs:
                return f"<{element}>{signs[name]}</{element}>"
        if name in SPACES:
            return f'<mspace width="{SPACES[name]}"></mspace>'
        if name == "sqrt":
            return f"<msqrt>{self._piece()}</msqrt>"
        if name == "frac":
            return f"<mfrac>{self._piece()}{self._piece()}</mfrac>"
        if name in ACCENTS:
            return f'<mover accent="true">{self._piece()}<mo>{ACCENTS[name]}</mo></mover>'
        raise ValueError(f"equation must have known commands, not {chr(92) + name!r}")

    def _worded(self, name: str, words: str) -> str:
        """Set text, or a block of rows and columns."""
        if name == "text":
            return f"<mtext>{escape(words).replace(' ', NO_BREAK)}</mtext>"
        if name != "begin" or words not in BLOCKS:
            raise ValueError(f"equation must have known blocks, not {name} of {words!r}")
        opening, closing, columns = BLOCKS[words]
        rows = [[""]]
        while not self._sees(f"\\end{{{words}}}"):
            if self._sees("&"):
                self._take()
                rows[-1].append("")
            elif self._sees(r"\\"):
                self._take()
                rows.append([""])
            else:
                rows[-1][-1] += self._scripted()
        self._take()
        table = ""
        for row in rows:
            cells = (
                f'<mtd style="text-align: {columns[number % len(columns)]}">{cell}</mtd>'
                for number, cell in enumerate(row)
            )
            table += f"<mtr>{''.join(cells)}</mtr>"
        before, after = (f"<mo>{sign}</mo>" if sign else "" for sign in (opening, closing))
        return f'<mrow>{before}<mtable displaystyle="true">{table}</mtable>{after}</mrow>'
