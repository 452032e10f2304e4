"""Waivers for Verilator's lint: what the generator of the Verilog writes, and is no mistake."""

__all__ = ["lint_waivers"]

#: Operators whose operands Verilog extends by itself. Assignments and ports are not among them.
_OPERATORS = (
    "ADD", "SUB", "MUL", "MULS", "AND", "OR", "XOR", "EQ", "NEQ", "LT", "LTS", "LTE", "LTES",
    "GT", "GTS", "GTE", "GTES", "COND",
)  # fmt: skip

#: Rule, beginning and rest of its messages, and why they are no mistake.
_WAIVERS = (
    ("DECLFILENAME", ("Filename * does not match MODULE name*",),
     "All modules of a core are in one file."),
    ("UNUSEDSIGNAL", ("Signal is not used*", "Bits of signal are not used*",
                      "Signal is not driven, nor used*"),
     "Interfaces have a name for every member, and results of operators every bit, used or not."),
    ("PROCASSINIT", ("Procedural assignment to declaration with initial value*",),
     "Registers and defaults have an initial value, which is that of a reset."),
    ("CASEINCOMPLETE", ("Case values incompletely covered*",),
     "The default stands before the case."),
    ("WIDTHEXPAND", tuple(f"Operator {operator} expects*" for operator in _OPERATORS),
     "Operands are as wide as they are; the wider one decides."),
    ("WIDTHTRUNC", ("Logical operator LOGNOT expects 1 bit*",),
     "Whether a number is zero is its logical negation."),
    ("WIDTHTRUNC", ("*expects * bits on the Assign RHS, but Assign RHS's SHIFTR generates*",),
     "The element of an array of constants is the low end of the array, shifted."),
    ("UNSIGNED", ("Comparison is constant due to unsigned arithmetic*",),
     "A limit that a core of these sizes does not need is the constant 0."),
    ("ASCRANGE", ("Ascending bit range vector: left < right of bit range: [-1:0]*",),
     "A signal that can have one value only has no bits."),
)  # fmt: skip


def lint_waivers(name: str) -> str:
    """Render waivers with which ``verilator --lint-only -Wall`` has nothing to say of a core.

    Each is of one rule, one form of its messages, and the file of the core; whatever else the rule
    finds is still reported, as is everything in other files.

    Parameters
    ----------
    name
        Name of the core, stem of its file.
    """
    lines = [
        f"// Waivers for verilator --lint-only -Wall {name}.vlt {name}.v. Generated, do not edit.",
        "`verilator_config",
    ]
    for rule, messages, reason in _WAIVERS:
        lines += [
            "",
            f"// {reason}",
            *(
                f'lint_off -rule {rule} -file "{folder}{name}.v" -match "{text}"'
                for text in messages
                for folder in ("", "*/")
            ),
        ]
    return "\n".join([*lines, ""])
