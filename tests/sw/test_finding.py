"""Problems by name: found in modules of the user, or refused with a message that says why."""

import importlib
import sys

import numpy as np
import pytest

from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.finding import ProblemNotFoundError, digest_of_modules, find
from ukf_sw.problems.logs import LogFiles
from ukf_sw.problems.recipe import Recipe

CART = """
import numpy as np
from ukf_sw.problem import Data, Problem, Sensor
from cart.rates import DT


def f(x, w, u):
    return np.array([x[0] + DT * x[1], x[1] + w[0]])


def simulate(seed, steps):
    steps = 20 if steps is None else steps
    z = np.random.default_rng(seed).standard_normal((20, 1))[:steps]
    return Data(times=DT * np.arange(1, steps + 1), measurements=z, truth=np.zeros((steps, 2)))


problem = Problem(
    name="cart", f=f, Q=[[0.01]], sensors={"gps": Sensor(lambda x, v: x[:1] + v, R=[[1.0]])},
    x0=[0.0, 0.0], P0=np.eye(2), states={"position": "m", "speed": "m/s"}, data=simulate, pes=2,
)
other, number = problem, 7
"""


@pytest.fixture
def cart(tmp_path, monkeypatch):
    """Folder with a package `cart`, current; nothing of it stays imported."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "cart").mkdir()
    (tmp_path / "cart" / "__init__.py").write_text("")
    (tmp_path / "cart" / "rates.py").write_text("DT = 0.5\n")
    (tmp_path / "cart" / "model.py").write_text(CART)
    importlib.invalidate_caches()
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if name.partition(".")[0] in ("cart", "broken", "torn", "lonely"):
            del sys.modules[name]


def test_a_problem_of_a_module_is_like_one_of_the_catalogue(cart):
    found = find("cart.model:problem")
    assert (found.name, found.params.n, found.params.pes, found.redraws) == (
        "cart.model:problem", 2, 2, False,
    )  # fmt: skip
    assert found.problem.name == "cart"
    assert found.scenario(3, 5).steps == 5
    assert not found.recorded
    assert find("nanosat") is CATALOGUE["nanosat"]


def test_it_is_found_from_other_folders_by_its_recipe(cart, tmp_path_factory, monkeypatch):
    """As the process of a simulator does, which works elsewhere."""
    recipe = Recipe.of("cart.model:problem", seed=2)
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    for name in [name for name in sys.modules if name.startswith("cart")]:
        del sys.modules[name]
    sys.path[:] = [path for path in sys.path if path != str(cart)]
    measured = recipe.scenario(4).record.measurements["gps"]
    np.testing.assert_array_equal(measured, np.random.default_rng(2).standard_normal((20, 1))[:4])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nanosatt", (r"must be one of nanosat, .*, or a module and an attribute, as "
         r"strut\.model:problem, not 'nanosatt'$")),
        ("cart", r"must be one of .* not 'cart'$"),
        ("cart.model:", (r"must be a module and an attribute, as strut\.model:problem, not "
         r"'cart\.model:'$")),
        (":problem", r"must be a module and an attribute"),
        ("cart/model.py:problem", r"must be a module and an attribute"),
        ("wagon.model:problem", (r"must be in a module that can be imported, and wagon is neither "
         r"in \S+ nor installed$")),
        ("cart.data:problem", (r"must be in a module that can be imported, and cart\.data is "
         r"neither")),
        ("cart.model:start", (r"must be a Problem, and start of cart\.model is missing; problems "
         r"there: problem, other$")),
        ("cart.model:number", (r"must be a Problem, and number of cart\.model is of the class int; "
         r"problems")),
        ("cart.rates:DT", (r"must be a Problem, and DT of cart\.rates is of the class float; there "
         r"is no problem there$")),
        ("broken:problem", (r"must be in a module that can be imported, and broken cannot: "
         r"ValueError: x0 must have the shape \(2,\), not \(3,\) \(\S+broken\.py, line 3\)$")),
        ("torn:problem", (r"must be in a module that can be imported, and torn cannot: "
         r"SyntaxError: .* \(\S+torn\.py, line 2\)$")),
        ("lonely:problem", (r"must be in a module that can be imported, and lonely cannot: "
         r"ModuleNotFoundError: No module named 'no_such_package' \(\S+lonely\.py, line 1\)$")),
    ],
)  # fmt: skip
def test_wrong_names_are_refused(cart, name, message):
    (cart / "broken.py").write_text(
        "from ukf_sw.arrays import as_vector\n\nx0 = as_vector([1.0, 2.0, 3.0], 'x0', 2)\n"
    )
    (cart / "torn.py").write_text("def f(x, w, u):\n    return (x\n")
    (cart / "lonely.py").write_text("import no_such_package\n")
    with pytest.raises(ProblemNotFoundError, match="^--problem " + message):
        find(name, "--problem")


def test_seeds_and_cores_are_checked(cart):
    recipe = Recipe.of("cart.model:problem", seed=1, pes=1)
    assert recipe.params.pes == 1
    (cart / "log.csv").write_text("time,gps\n0.5,1.0\n1.0,\n1.5,3.0\n")
    logs = LogFiles.of(["log.csv"])
    made = Recipe.of("cart.model:problem", logs=logs).scenario()
    np.testing.assert_array_equal(made.samples()[0], [[1.0], [np.nan], [3.0]])
    with pytest.raises(ValueError, match=r"^seed must be 0 for .*, which is a record, not 1$"):
        Recipe.of("cart.model:problem", logs=logs, seed=1)
    with pytest.raises(ValueError, match=r"^steps must be between 1 and 3, not 4$"):
        Recipe.of("cart.model:problem", logs=logs).scenario(4)
    with pytest.raises(ValueError, match=r"^params must have the sizes and kinds of noise of cart"):
        Recipe(name="cart.model:problem", params=CATALOGUE["nanosat"].params)
    with pytest.raises(ValueError, match=r"^data must be of a problem, not of sizes alone$"):
        Recipe(params=recipe.params, logs=logs)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (
            ["a.csv", "b.csv"],
            "data must have a name for each file, as gps=gps.csv, not only .*a.csv and b.csv",
        ),
        (["gps=a.csv", "gps=b.csv"], "data must have one file named 'gps', not several"),
        (["gps=a.csv", "b.csv"], "data must have a name for each file, as gps=gps.csv, not only"),
    ],
)
def test_wrong_sets_of_files_are_refused(texts, message):
    with pytest.raises(ValueError, match="^" + message):
        LogFiles.of(texts)


def test_what_a_scenario_depends_on(cart):
    """Another model, seed, log or number of steps is another scenario; the same is the same."""
    recipe = Recipe.of("cart.model:problem")
    first = recipe.identity(5)
    assert first == recipe.identity(5)
    assert first != recipe.identity(6)
    assert first["data"] != Recipe.of("cart.model:problem", seed=1).identity(5)["data"]
    before = digest_of_modules("cart.model:problem")
    (cart / "cart" / "rates.py").write_text("DT = 0.25\n")
    assert digest_of_modules("cart.model:problem") != before
    assert recipe.identity(5) != first  # though the data are the same
    (cart / "log.csv").write_text("time,gps\n0.5,1.0\n")
    log = Recipe.of("cart.model:problem", logs=LogFiles.of(["log.csv"]))
    one = log.identity(1)
    (cart / "log.csv").write_text("time,gps\n0.5,2.0\n")
    assert log.identity(1) != one


def test_data_that_cannot_be_told_apart_are_always_others(cart):
    model = find("cart.model:problem") and sys.modules["cart.model"]
    data = Data(times=np.ones(1), measurements=np.ones((1, 1)), inputs=[lambda: None])
    model.problem = Problem(
        name="cart", f=model.f, Q=[[0.01]], sensors=Sensor(lambda x, v: x[:1] + v, R=[[1.0]]),
        x0=[0.0, 0.0], P0=np.eye(2), data=data,
    )  # fmt: skip
    recipe = Recipe.of("cart.model:problem")
    assert recipe.identity(1) != recipe.identity(1)


def test_entries_say_what_their_problems_do():
    """What is known of an entry without its data is what they have."""
    for entry in CATALOGUE.values():
        if entry.name != "swampsat":  # which needs packages
            made = entry.scenario(0, 1)
            assert (made.redraws, made.params) == (entry.redraws, entry.params)
