"""FuseSoC's generator: called with a file of parameters, it writes files into the current folder.

Parameters are ``command``, generate or testbench, and ``options``, those of ``ukf`` with that
command, without their dashes. See ``ukf_core.core``.
"""

import json
import sys
from pathlib import Path

import yaml
from typer.main import get_command

from ukf_tools.cli import app

__all__ = ["main"]

#: What FuseSoC does with a file, by its ending; it knows others as data beside the simulation.
_KINDS = {".v": "verilogSource", ".vlt": "vlt"}
_COMMANDS = ("generate", "testbench")


def main(parameters: Path) -> None:
    """Run the command, and write a core file that names its files.

    Raises
    ------
    ValueError
        If it is another command.
    """
    call = yaml.safe_load(parameters.read_text(encoding="utf-8"))
    command, options = call["parameters"]["command"], call["parameters"]["options"]
    if command not in _COMMANDS:
        raise ValueError(f"command must be one of {', '.join(_COMMANDS)}, not {command!r}")
    before = set(Path().iterdir())
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    get_command(app).main([command, *words, "--output", "."], standalone_mode=False)
    files = [
        {str(path): {"file_type": _KINDS.get(path.suffix, "user"), "copyto": path.name}}
        for path in sorted(set(Path().iterdir()) - before)
        if path.is_file()
    ]
    core = {
        "name": call["vlnv"],
        "filesets": {"files": {"files": files}},
        "targets": {"default": {"filesets": ["files"]}},
    }
    text = "CAPI=2:\n" + json.dumps(core, indent=2) + "\n"
    Path(call["vlnv"].split(":")[2]).with_suffix(".core").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
