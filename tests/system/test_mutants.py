"""The list of mutants keeps up with the sources; running them takes long."""

import importlib.util
from pathlib import Path

LIST = Path(__file__).parents[1] / "mutants" / "run.py"


def test_every_mutant_changes_one_place():
    spec = importlib.util.spec_from_file_location("mutants", LIST)
    mutants = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(mutants)
    assert len(mutants.MUTANTS) > 100
    for mutant in mutants.MUTANTS:
        text = (mutants.ROOT / mutant.file).read_text(encoding="utf-8")
        assert text.count(mutant.before) == 1, mutant.name
        assert mutant.before != mutant.after, mutant.name
