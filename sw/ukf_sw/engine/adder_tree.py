"""How the adders of the lanes form the tree of the dot product."""

from dataclasses import dataclass
from functools import cache

__all__ = ["Node", "Source", "adder_tree"]


@dataclass(frozen=True)
class Source:
    """What an adder of the tree adds: a lane's product or a lane's sum, some levels old.

    Parameters
    ----------
    lane
        Lane that it comes from.
    is_sum
        Whether it is the output of that lane's adder, else the lane's product.
    wait
        Levels for which it waits because its level had an odd number of terms.
    """

    lane: int
    is_sum: bool
    wait: int = 0


@dataclass(frozen=True)
class Node:
    """An adder of the tree.

    Parameters
    ----------
    level
        Level, 0 next to the products.
    lane
        Lane whose adder it is.
    left, right
        What it adds.
    """

    level: int
    lane: int
    left: Source
    right: Source


@cache
def adder_tree(pes: int) -> tuple[tuple[Node, ...], Source]:
    """Build the tree over the products of all lanes.

    Terms are added in pairs, level by level; the last of an odd number waits. The sum of terms
    up to lane b is formed in lane b, for the left term's last lane b, so every lane but the last
    has one adder of the tree and the last lane's is free to accumulate.

    Returns
    -------
    nodes, root
        Adders by rising level, and the sum of all.
    """
    nodes: list[Node] = []
    terms = [(lane, Source(lane, False)) for lane in range(pes)]  # last lane covered, source
    level = 0
    while len(terms) > 1:
        paired: list[tuple[int, Source]] = []
        for (boundary, left), (last, right) in zip(terms[::2], terms[1::2], strict=False):
            nodes.append(Node(level, boundary, left, right))
            paired.append((last, Source(boundary, True)))
        if len(terms) % 2:
            last, source = terms[-1]
            paired.append((last, Source(source.lane, source.is_sum, source.wait + 1)))
        terms = paired
        level += 1
    return tuple(nodes), terms[0][1]
