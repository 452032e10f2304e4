"""A study of SwampSat that nobody flew."""

__all__ = ["study_of"]


def study_of(median=1.0):
    """A study in which every error is the same."""
    found = {"median": median, "seeds": [median] * 5, "diverged": 0}
    columns = ("quest_sample", "quest_held", "ekf", "ukf_reference", "ukf_golden")
    points = [
        {"latency_s": 1.0, "loss": 0.0, "age_s": 1.05, "used": 0.5, "naive": found,
         "compensated": found}
    ]  # fmt: skip
    return {
        "rows": [
            {"name": name, "interval_s": 2.0} | dict.fromkeys(columns, found)
            for name in ("2 s", "5 s")
        ],
        "platform": {"delays": points, "losses": [], "interval_s": 2.0, "seeds": [0]},
        "eclipse": {"sunlit": dict.fromkeys(columns, found), "seeds": [0],
                    "eclipse": dict.fromkeys(columns, found)},
        "curves": {
            "2 s": {
                column: {"times": [1.0, 2.0], "attitude": [median] * 2, "bias": [[0.1] * 3] * 2}
                for column in columns
            }
        },
        "duration_s": 3000.0, "settled_after_s": 1500.0, "seeds": list(range(5)),
        "unit": "degrees", "columns": list(columns),
    }  # fmt: skip
