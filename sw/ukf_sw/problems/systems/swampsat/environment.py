"""What the satellite's sensors see: direction of the Sun, magnetic field, eclipse.

The Sun comes from the Earth's ephemeris VSOP2000 in pyerfa (ERFA, the IAU's SOFA), the field from
the International Geomagnetic Reference Field in ppigrf. Neither needs the network.
"""

from datetime import datetime, timezone
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.extras import importing
from ukf_sw.problems.systems.swampsat.orbit import EARTH_RADIUS_KM

with importing("apps"):
    # Neither has types; a module that is imported so is Any to the type checker.
    erfa: Any = import_module("erfa")
    ppigrf: Any = import_module("ppigrf")

__all__ = ["in_eclipse", "inertial_to_earth", "magnetic_field", "sun_direction"]

Array = NDArray[np.float64]

DAY = 86400.0
#: Years that IGRF covers.
YEARS = (1900, 2030)


def _universal_time(epoch: datetime) -> tuple[float, float]:
    """UTC of an epoch, as a two-part Julian date."""
    seconds = epoch.second + epoch.microsecond * 1e-6
    whole, part = erfa.dtf2d(
        "UTC", epoch.year, epoch.month, epoch.day, epoch.hour, epoch.minute, seconds
    )
    return float(whole), float(part)


def _terrestrial_time(epoch: datetime) -> tuple[float, float]:
    """Terrestrial time of an epoch, as a two-part Julian date."""
    whole, part = erfa.taitt(*erfa.utctai(*_universal_time(epoch)))
    return float(whole), float(part)


def _check_epoch(epoch: datetime) -> datetime:
    """Check an epoch: an instant, and covered by the models."""
    if epoch.tzinfo is None:
        raise ValueError(f"epoch must have a time zone, not {epoch!r}")
    instant = epoch.astimezone(timezone.utc)
    # UTC began in 1960; pyerfa warns of times before.
    if not 1960 <= instant.year < YEARS[1]:
        raise ValueError(f"epoch must be between 1960 and {YEARS[1] - 1}, not {epoch!r}")
    return instant


def sun_direction(epoch: datetime, times: Array) -> Array:
    """Direction of the Sun from the centre of the Earth.

    Seen from a low orbit it differs by at most 0.003 degrees; aberration is 0.006 degrees.

    Parameters
    ----------
    epoch
        Time 0, with time zone.
    times
        Times since then, shape (K,), s.

    Returns
    -------
    array of shape (3, K)
        Unit vectors, inertial (GCRS).

    Raises
    ------
    ValueError
        If the epoch has no time zone or is not between 1960 and 2029.
    """
    whole, part = _terrestrial_time(_check_epoch(epoch))
    heliocentric, _ = erfa.epv00(whole, part + np.asarray(times) / DAY)  # TDB - TT < 2 ms
    sun = -np.asarray(heliocentric["p"], dtype=np.float64).T
    return sun / np.linalg.norm(sun, axis=0)


def inertial_to_earth(epoch: datetime, times: Array) -> Array:
    """Matrices from the inertial frame (GCRS) to that of the rotating Earth (ITRS).

    Precession and nutation (IAU 2006/2000A) are those of the middle time; the difference of UT1
    to UTC, below 0.004 degrees, and polar motion are left out.

    Parameters
    ----------
    epoch
        Time 0, with time zone.
    times
        Times since then, shape (K,), s; they may span days.

    Returns
    -------
    array of shape (3, 3, K)

    Raises
    ------
    ValueError
        As :func:`sun_direction`.
    """
    instant = _check_epoch(epoch)
    times = np.asarray(times, dtype=np.float64)
    whole, part = _terrestrial_time(instant)
    celestial = np.asarray(erfa.c2i06a(whole, part + float(np.median(times)) / DAY))
    day, fraction = _universal_time(instant)
    angle = np.asarray(erfa.era00(day, fraction + times / DAY), dtype=np.float64)
    cosine, sine, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    spin = np.array([[cosine, sine, zero], [-sine, cosine, zero], [zero, zero, zero + 1.0]])
    return np.einsum("ijk,jl->ilk", spin, celestial)


def magnetic_field(epoch: datetime, times: Array, position: Array) -> Array:
    """Magnetic field of the Earth (IGRF).

    Parameters
    ----------
    epoch
        Time 0, with time zone; the coefficients are those of this time.
    times
        Times since then, shape (K,), s.
    position
        Positions from the centre of the Earth, inertial (GCRS), shape (3, K), km.

    Returns
    -------
    array of shape (3, K)
        Field, inertial (GCRS), nT.

    Raises
    ------
    ValueError
        As :func:`sun_direction`.
    """
    turn = inertial_to_earth(epoch, times)
    x, y, z = np.einsum("ijk,jk->ik", turn, position)
    radius = np.sqrt(x * x + y * y + z * z)
    colatitude, longitude = np.arccos(z / radius), np.arctan2(y, x)
    field = ppigrf.igrf_gc(
        radius, np.degrees(colatitude), np.degrees(longitude),
        _check_epoch(epoch).replace(tzinfo=None),
    )  # fmt: skip
    up, south, east = (np.asarray(part, dtype=np.float64)[0] for part in field)
    ct, st, cp, sp = np.cos(colatitude), np.sin(colatitude), np.cos(longitude), np.sin(longitude)
    outward = up * st + south * ct
    earth = np.array([outward * cp - east * sp, outward * sp + east * cp, up * ct - south * st])
    return np.einsum("jik,jk->ik", turn, earth)


def in_eclipse(position: Array, sun: Array) -> NDArray[np.bool_]:
    """Find out where the Earth hides the Sun, with a shadow that is a cylinder.

    Parameters
    ----------
    position
        Positions from the centre of the Earth, shape (3, K), km.
    sun
        Directions of the Sun, shape (3, K).

    Returns
    -------
    array of bool, shape (K,)
    """
    along = np.sum(position * sun, axis=0)
    beside = np.linalg.norm(position - along * sun, axis=0)
    return (along < 0.0) & (beside < EARTH_RADIUS_KM)
