"""Boards that a core can be packaged for."""

from dataclasses import dataclass

__all__ = ["BOARDS", "Board"]


@dataclass(frozen=True, kw_only=True)
class Board:
    """A board with a Zynq-7000.

    Parameters
    ----------
    name
        Name on the command line.
    part
        The device.
    board_parts
        Patterns of names of its board files in Vivado, the preferred ones first; their versions
        depend on what is installed.
    """

    name: str
    part: str
    board_parts: tuple[str, ...]


BOARDS = {
    board.name: board
    for board in (
        Board(
            name="zedboard",
            part="xc7z020clg484-1",
            board_parts=(
                "avnet.com:zedboard:part0:*",
                "em.avnet.com:zed:part0:*",
                "digilentinc.com:zedboard:part0:*",
            ),
        ),
        Board(name="pynq-z2", part="xc7z020clg400-1", board_parts=("tul.com.tw:pynq-z2:part0:*",)),
    )
}
