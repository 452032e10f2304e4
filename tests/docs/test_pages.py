"""Pages whose code is executed."""

from pathlib import Path

import pytest

from ukf_docs.pages import PAGES, refresh


@pytest.mark.system
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_show_what_their_code_prints(page, core_cache):
    """Run `make refresh` if this fails because of other numbers."""
    text = page.read_text(encoding="utf-8")
    assert refresh(text, cache=core_cache) == text
    for works in ("bit-exact: True", "golden model: True"):
        assert works in text


def page(*blocks):
    return "".join(f"```{kind}\n{content}```\n\n" for kind, content in blocks)


def test_output_is_replaced_and_the_rest_stays():
    before = Path.cwd()
    text = page(
        ('python title="own_module.py"', "x = 1\n"),
        ("python", "from own_module import x\n"),
        ("python", "print(x + 1)\n"), ("text", "old\n"),
        ('python title="own_module.py"', "y = 2 * x\n"),
        ("python", "import own_module\nprint(own_module.y)\n"), ("text", ""),
        ("sh", "cat own_module.py\n"), ("text", "old\n"),
        ("python", "cosimulate = print(3)\n"), ("text", "stays\n"),
        ("c", "int x;\n"), ("text", "stays, too\n"),
    )  # fmt: skip
    expected = text.replace("old", "2", 1).replace("```text\n```", "```text\n2\n```")
    expected = expected.replace("old\n", "x = 1\ny = 2 * x\n")
    assert refresh(text, cosimulation=False) == expected
    assert Path.cwd() == before
    with pytest.raises(ModuleNotFoundError):
        import own_module  # noqa: F401


def test_output_without_a_place_is_an_error():
    with pytest.raises(
        ValueError, match=r"^A block text must follow the block that prints '3\\n'$"
    ):
        refresh(page(("python", "print(3)\n")))


def test_errors_name_their_block():
    with pytest.raises(ZeroDivisionError) as caught:
        refresh(page(("python", "x = 0\n1 / x\n")))
    assert caught.value.__notes__ == ["in the block that begins with 'x = 0'"]
