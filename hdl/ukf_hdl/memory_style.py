"""Which kind of memory synthesis is to take, in the attributes that Vivado and Yosys know.

Without them it is the tool's guess, which may change with its version, and takes look-up tables or
block memories by the hundred.
"""

__all__ = ["ram_style", "rom_style"]

#: Words that a RAM64M holds; deeper memories are put together of several, with multiplexers.
_DISTRIBUTED_DEPTH = 64
#: Bits from which a deeper memory is worth a block memory.
_BLOCK_BITS = 4096
#: Bits from which a table is: half of a RAMB18.
_BLOCK_TABLE_BITS = 9216


def ram_style(depth: int, width: int, *, clocked: bool = True) -> dict[str, str]:
    """Attributes of a memory that is written.

    Parameters
    ----------
    depth, width
        Words, and bits of each.
    clocked
        Whether it is read with a clock, as block memories are.
    """
    block = clocked and depth > _DISTRIBUTED_DEPTH and depth * width >= _BLOCK_BITS
    return {"ram_style": "block" if block else "distributed"}


def rom_style(depth: int, width: int) -> dict[str, str]:
    """Attributes of a table that is read with a clock.

    A small one has none: it is to be look-up tables, for which Yosys has no word.

    Parameters
    ----------
    depth, width
        Words, and bits of each.
    """
    return {"rom_style": "block"} if depth * width >= _BLOCK_TABLE_BITS else {}
