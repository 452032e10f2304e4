"""Bus words of an iteration, by formula."""

from ukf_sw.spec.parameters import UkfParams

__all__ = ["bus_words"]


def bus_words(params: UkfParams, *, redraws: bool) -> int:
    """Give the bus words that an iteration cannot do without: numbers, and starts of steps.

    They are what :attr:`ukf_sw.drivers.driver.Traffic.words` counts, with every sensor observed,
    the estimate read once, and all inputs of models on the core changing in every iteration. Words
    that wait for the end of a step, and read its NIS, are not among them.

    Parameters
    ----------
    params
        The core, with the models that it evaluates.
    redraws
        Whether the filter draws new sigma points after every predict.
    """
    n, models, points = params.n, params.models, len(params.points)
    f, h = models.f is not None, bool(models.h)
    sensors = len(params.sensor_rows)
    # Reading sigma points of the state: those beyond column n + 1 are equal to x.
    drawn = n * (n + 2 - params.points.start)
    # Updates that need points of their own: all but one that has those of the prediction.
    draws_of_h = 0 if h else sensors - 1 + redraws
    numbers = n + params.m + len(models.inputs)  # x, z, u
    if not f:
        numbers += drawn + n * points
    if not h:
        numbers += params.m * points
        # Without sigma point 0, which is x, that is read as well.
        numbers += draws_of_h * (drawn + n * params.points.start)
        if f and not redraws:
            numbers += n * points
    # Whatever reads sigma points starts SIG_GEN first.
    starts = 1 + redraws + sensors + draws_of_h + (not f)
    if f and h and not redraws:
        starts -= 1
    return numbers * params.format.bus_words + starts
