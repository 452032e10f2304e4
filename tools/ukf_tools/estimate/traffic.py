"""Bus words of an iteration, by formula."""

from ukf_sw.drivers.driver import Traffic
from ukf_sw.spec.parameters import UkfParams

__all__ = ["bus_words", "traffic_of"]


def traffic_of(params: UkfParams, *, redraws: bool) -> Traffic:
    """Give the bus words of an iteration, as the driver counts them.

    Every sensor is observed, the estimate is read once, and all inputs of models on the core change
    in every iteration. Each step is found ended on the first look.

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
    read, written = n, params.m + len(models.inputs)  # x; z and u
    if not f:
        read += drawn
        written += n * points
    if not h:
        written += params.m * points
        # Without sigma point 0, which is x, that is read as well.
        read += draws_of_h * (drawn + n * params.points.start)
        if f and not redraws:
            read += n * points
    # Whatever reads sigma points starts SIG_GEN first.
    starts = 1 + redraws + sensors + draws_of_h + (not f)
    if f and h and not redraws:
        starts -= 1
    size = params.format.bus_words
    return Traffic(
        words_read=read * size,
        words_written=written * size,
        starts=starts,
        # STATUS and ERROR after each step, and the NIS of each update.
        control_reads=2 * starts + sensors * size,
    )


def bus_words(params: UkfParams, *, redraws: bool) -> int:
    """Give the bus words that an iteration cannot do without: numbers, and starts of steps.

    The parameters are those of :func:`traffic_of`.
    """
    return traffic_of(params, redraws=redraws).words
