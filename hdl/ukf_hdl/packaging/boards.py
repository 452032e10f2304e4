"""Boards and devices that a core can be packaged for."""

import re
from dataclasses import dataclass

__all__ = ["BOARDS", "Board", "find_board"]


@dataclass(frozen=True, kw_only=True)
class Board:
    """A board with a Zynq-7000, or a device alone.

    Parameters
    ----------
    name
        Name on the command line and in AMD's board store.
    part
        The device.
    board_parts
        Patterns of names of its board files in Vivado, the preferred ones first; their versions
        depend on what is installed. None for a device alone: then nobody knows the pins and the
        memory.
    """

    name: str
    part: str
    board_parts: tuple[str, ...] = ()


BOARDS = {
    board.name: board
    for board in (
        Board(
            name="zedboard",
            part="xc7z020clg484-1",
            # Avnet's embedded boards are sold as Tria since version 1.5 of the files.
            board_parts=(
                "avnet-tria:zedboard:part0:*",
                "avnet.com:zedboard:part0:*",
                "em.avnet.com:zed:part0:*",
                "digilentinc.com:zedboard:part0:*",
            ),
        ),
        Board(name="pynq-z2", part="xc7z020clg400-1", board_parts=("tul.com.tw:pynq-z2:part0:*",)),
    )
}

_ZYNQ_7000 = re.compile(
    r"x[acq]7z(007s|010|012s|014s|015|020|030|035|045|100)[a-z]{3}\d{3,4}-[123][a-z]*"
)


def find_board(name: str | None, part: str | None) -> Board:
    """Give the board of a name, or, without a board, a device.

    Parameters
    ----------
    name
        Name of a board, or None.
    part
        A Zynq-7000 with package and speed grade, as Vivado calls it; with a board, None or its own.

    Raises
    ------
    ValueError
        If neither is given, there is no such board, the device is no Zynq-7000, or the board has
        another.
    """
    if name is None and part is None:
        raise ValueError(f"--board must be given, one of {', '.join(BOARDS)}; or --part")
    if part is not None and not _ZYNQ_7000.fullmatch(part):
        raise ValueError(f"--part must be a Zynq-7000, as xc7z020clg484-1, not {part!r}")
    if name is None:
        return Board(name=str(part), part=str(part))
    if name not in BOARDS:
        raise ValueError(f"--board must be one of {', '.join(BOARDS)}, not {name!r}")
    board = BOARDS[name]
    if part not in (None, board.part):
        raise ValueError(f"--part must be {board.part}, which the {name} has, not {part!r}")
    return board
