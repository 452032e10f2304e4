"""Equations of the pages, as MathML."""

from xml.etree import ElementTree

import pytest

from ukf_docs.equations import fence, mathml


def inner(source):
    """What stands in the element math."""
    found = mathml(source)
    ElementTree.fromstring(found)  # is well-formed
    return found.removeprefix('<math display="block">').removesuffix("</math>")


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("x - 1.5", "<mi>x</mi><mo>−</mo><mn>1.5</mn>"),
        ("a < b", "<mi>a</mi><mo>&lt;</mo><mi>b</mi>"),
        (r"\sigma_k", "<msub><mi>σ</mi><mi>k</mi></msub>"),
        ("e^{-1}", "<msup><mi>e</mi><mrow><mo>−</mo><mn>1</mn></mrow></msup>"),
        (r"P^\top_z", "<msubsup><mi>P</mi><mi>z</mi><mi>⊤</mi></msubsup>"),
        ("x'", '<msup><mi>x</mi><mo lspace="0" rspace="0">′</mo></msup>'),
        (r"\sum_k", "<munder><mo>∑</mo><mi>k</mi></munder>"),
        (r"\frac{1}\sqrt d", "<mfrac><mrow><mn>1</mn></mrow><msqrt><mi>d</mi></msqrt></mfrac>"),
        (r"\bar x", '<mover accent="true"><mi>x</mi><mo>¯</mo></mover>'),
        (r"\text{if } x", "<mtext>if\N{NO-BREAK SPACE}</mtext><mi>x</mi>"),
        (r"\quad", '<mspace width="1em"></mspace>'),
    ],
)
def test_pieces(source, expected):
    assert inner(source) == expected


def test_blocks_have_rows_and_columns():
    root = ElementTree.fromstring(mathml(r"\begin{bmatrix} a & b \\ c & d \end{bmatrix} x"))
    rows = [["".join(cell.itertext()) for cell in row] for row in root.iter("mtr")]
    assert rows == [["a", "b"], ["c", "d"]]
    assert [mark.text for mark in root.iter("mo")] == ["[", "]"]
    root = ElementTree.fromstring(mathml(r"\begin{aligned} a &= b \end{aligned}"))
    assert [cell.get("style") for cell in root.iter("mtd")] == [
        "text-align: right", "text-align: left",
    ]  # fmt: skip
    assert fence("x") == f'<div class="equation">{mathml("x")}</div>'


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (r"\frac{1}", "equation must be complete, not"),
        ("{a", "equation must be complete, not '{a'"),
        (r"\begin{aligned} a", "equation must be complete, not"),
        ("a}", "equation must have its } in a block, not 'a}'"),
        (r"\wrong", r"equation must have known commands, not '\\\\wrong'"),
        (r"\begin{cases}", "equation must have known blocks, not begin of 'cases'"),
        ("a_b_c", "equation must have one script _, not 'a_b_c'"),
    ],
)
def test_what_is_not_understood_is_an_error(source, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        mathml(source)
