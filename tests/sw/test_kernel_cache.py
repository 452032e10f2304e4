"""Compiled functions on disk, tried on a copy of the package in processes of their own."""

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core import caching

import ukf_sw
from ukf_sw.backends import make_backend
from ukf_sw.engine import interpreter, kernel_cache
from ukf_sw.spec.float_format import BINARY16, BINARY64
from ukf_sw.spec.parameters import Form, UkfParams

#: A compiled function that calls one of another file and holds a constant of a third one.
PROBE = """
import json

from ukf_sw.engine.arithmetic import add_scalar, scalar_parameters
from ukf_sw.engine.kernel_cache import compiled
from ukf_sw.spec.float_format import BINARY32
from ukf_sw.spec.registers import ErrorCode

CODE = int(ErrorCode.NOT_FINITE)


@compiled
def probe(a, b, parameters):
    return add_scalar(a, b, parameters) + CODE


def main():
    value = probe(1.0, 2.0, scalar_parameters(BINARY32))
    print(json.dumps([value, sum(probe.stats.cache_hits.values())]))
"""
CODE = 2


class Package:
    """A copy of the package, with a probe in it."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "package"
        self.engine = self.root / "ukf_sw" / "engine"
        shutil.copytree(
            Path(ukf_sw.__file__).parent, self.root / "ukf_sw",
            ignore=shutil.ignore_patterns("__pycache__", "problems"),
        )  # fmt: skip
        (self.engine / "probe.py").write_text(PROBE)
        self.cache = folder / "cache"
        self.environment = {
            name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")
        } | {"PYTHONPATH": str(self.root), "PYTHONDONTWRITEBYTECODE": "1"}
        self.environment["NUMBA_CACHE_DIR"] = str(self.cache)

    def start(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", "from ukf_sw.engine.probe import main; main()"],
            env=self.environment, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def run(self) -> tuple[float, int]:
        """Call the probe: its value, and how often it came from the cache."""
        return self.end(self.start())

    def end(self, process: subprocess.Popen[str]) -> tuple[float, int]:
        output, _ = process.communicate(timeout=300)
        assert process.returncode == 0
        value, hits = json.loads(output)
        return value, hits

    def edit(self, file: str, old: str, new: str) -> None:
        path = self.root / "ukf_sw" / file
        text = path.read_text()
        assert text.count(old) == 1
        path.write_text(text.replace(old, new))

    def files(self, kind: str) -> list[Path]:
        return sorted(self.cache.rglob(f"probe.probe-*.{kind}"))


ADD = '    """Add two numbers; compiled."""\n'


@pytest.fixture
def package(tmp_path):
    return Package(tmp_path)


def test_a_change_of_what_is_called_or_referred_to_is_seen(package):
    assert package.run() == (3.0 + CODE, 0)
    assert package.run() == (3.0 + CODE, 1)
    (first,) = package.files("nbc")
    before = first.read_bytes()
    package.edit("engine/arithmetic.py", ADD, f"{ADD}    a = 10.0 * a\n")
    assert package.run() == (12.0 + CODE, 0)
    # As if a process with the old sources had written last.
    (changed,) = package.files("nbc")
    assert changed == first
    assert changed.read_bytes() != before
    changed.write_bytes(before)
    assert package.run() == (12.0 + CODE, 0)
    package.edit("spec/registers.py", f"NOT_FINITE = {CODE}", "NOT_FINITE = 40")
    assert package.run() == (52.0, 0)


@pytest.mark.slow
def test_damaged_files_are_written_anew(package):
    package.run()
    for kind in ("nbc", "nbi"):
        (file,) = package.files(kind)
        file.write_bytes(file.read_bytes()[:100])
        assert package.run() == (3.0 + CODE, 0)
    assert package.run() == (3.0 + CODE, 1)


def test_no_flipped_bit_is_taken(tmp_path):
    """Neither in the index nor in the data; a wrong bit of machine code would run."""
    rng = np.random.default_rng(0)
    key, data = ("signature", "processor"), {"code": rng.bytes(3000), "name": "probe"}

    def file():
        kept = caching.IndexDataCacheFile(str(tmp_path), "probe", kernel_cache.sources_digest())
        return kernel_cache._CheckedFile(kept)

    file().save(key, data)
    assert file().load(key) == data
    originals = {path: path.read_bytes() for path in sorted(tmp_path.iterdir())}
    refused = 0
    for path, original in originals.items():
        for position in rng.integers(8 * len(original), size=250):
            changed = bytearray(original)
            changed[position // 8] ^= 1 << position % 8
            path.write_bytes(changed)
            found = file().load(key)
            assert found in (None, data)
            refused += found is None
            for other, content in originals.items():
                other.write_bytes(content)
    assert refused > 300


def test_processes_that_start_at_once(package):
    for process in [package.start() for _ in range(3)]:
        assert package.end(process)[0] == 3.0 + CODE
    assert package.run() == (3.0 + CODE, 1)


def test_nothing_can_be_written(package):
    """Not even by root: files stand where the folders would be made."""
    del package.environment["NUMBA_CACHE_DIR"]
    (package.engine / "__pycache__").write_text("")
    nowhere = package.root / "file"
    nowhere.write_text("")
    package.environment |= {"HOME": str(nowhere), "XDG_CACHE_HOME": str(nowhere)}
    assert package.run() == (3.0 + CODE, 0)


@pytest.mark.slow
def test_a_folder_that_vanishes_does_not_fail_a_call(package):
    package.edit(
        "engine/probe.py", "    value =",
        "    import shutil\n"
        "    from pathlib import Path\n"
        f"    shutil.rmtree({str(package.cache)!r})\n"
        f"    Path({str(package.cache)!r}).write_text('')\n"
        "    value =",
    )  # fmt: skip
    assert package.run() == (3.0 + CODE, 0)


def test_one_compiled_function_serves_all_cores():
    rng = np.random.default_rng(1)
    for params in (
        UkfParams(n=1, m=1),
        UkfParams(n=2, m=2, q=1, pes=3, format=BINARY16),
        UkfParams(n=2, m=1, pes=2, format=BINARY64, form=Form.COVARIANCE),
    ):
        n, m = params.n, params.m
        backend = make_backend("golden", params)
        backend.initialise(np.zeros(n), np.eye(n), np.eye(params.q), np.eye(params.r))
        shape = backend.sigma_points().shape
        backend.predict(rng.standard_normal(shape))
        observed = rng.standard_normal((m, shape[1]))
        backend.update(observed, np.zeros(m), np.ones(m, dtype=bool))
    assert len(interpreter._execute.signatures) == 1


def test_compiled_functions_refer_to_what_the_digest_covers():
    """The packages in the digest import nothing else of the project."""
    root = Path(ukf_sw.__file__).parent
    for package in kernel_cache._PACKAGES:
        for file in (root / package.partition(".")[2]).glob("*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                names = []
                if isinstance(node, ast.ImportFrom):
                    assert node.level == 0
                    names = [node.module]
                elif isinstance(node, ast.Import):
                    names = [alias.name for alias in node.names]
                for name in names:
                    assert not name.startswith("ukf_sw") or name.startswith(
                        kernel_cache._PACKAGES
                    ), (file.name, name)
