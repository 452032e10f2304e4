"""Measurements that the documentation cites: ``python -m ukf_docs measure NAME``."""

from ukf_docs.studies import (
    baseline,
    bench,
    elementary,
    growth,
    iteration,
    numerics,
    resources,
    rounding,
    routing,
)

__all__ = ["STUDIES"]

STUDIES = {
    study.name: study
    for study in (
        resources.STUDY, growth.STUDY, routing.STUDY, bench.STUDY, numerics.STUDY, rounding.STUDY,
        iteration.STUDY, baseline.STUDY, elementary.STUDY,
    )
}  # fmt: skip
