"""Pages whose code is executed."""

import ast
import re
from pathlib import Path

import pytest

from ukf_docs import DOCS
from ukf_docs.pages import PAGES, SLOW, refresh

#: What stands on a page only if co-simulation works.
WORKS = {"own-model": ("bit-exact: True", "golden model: True"), "sensors": ("Bit-exact: ",)}


def name_of(page):
    return page.stem


def check(page, cache, **options):
    """Run `make refresh` if this fails because of other numbers."""
    text = page.read_text(encoding="utf-8")
    assert refresh(text, cache=cache, **options) == text
    for works in WORKS.get(page.stem, ()):
        assert works in text


def marks_of(page):
    """The page of sensors takes long, even without what takes long on all."""
    return [pytest.mark.slow] if page.stem == "sensors" else []


@pytest.mark.parametrize("page", [pytest.param(p, marks=marks_of(p)) for p in PAGES], ids=name_of)
def test_pages_show_what_their_code_prints(page, core_cache):
    """All but what compiles a core, or makes many."""
    check(page, core_cache, slow=False)


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.parametrize(("name", "commands"), [("sensors", 4), ("own-model", None)])
def test_pages_show_what_slow_commands_print(name, commands, core_cache):
    page = DOCS / f"{name}.md"
    found = len(SLOW.findall(page.read_text(encoding="utf-8")))
    assert found == commands if commands else found
    check(page, core_cache)


def test_models_of_the_page_of_sensors_give_equal_bits_in_c():
    """They take only what is rounded correctly everywhere: + - * / and square roots."""
    text = (DOCS / "sensors.md").read_text(encoding="utf-8")
    source = "".join(re.findall(r'(?ms)^```python title="rover.py"\n(.*?)^```', text))
    models = {
        node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)
    }
    for name in ("drive", "see_gps", "see_baro", "see_mag"):
        for node in ast.walk(models[name]):
            if isinstance(node, ast.Call):
                assert ast.unparse(node.func) in ("np.array", "np.sqrt")
            if isinstance(node, ast.BinOp):
                assert isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div)


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
        ("sh", "false; ukf cosim\n"), ("text", "stays\n"),
        ("c", "int x;\n"), ("text", "stays, too\n"),
    )  # fmt: skip
    expected = text.replace("old", "2", 1).replace("```text\n```", "```text\n2\n```")
    expected = expected.replace("old\n", "x = 1\ny = 2 * x\n")
    assert refresh(text, slow=False) == expected
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
