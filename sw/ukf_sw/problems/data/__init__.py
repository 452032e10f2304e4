"""Recorded data that come with the package; ``README.md`` beside this file has their licences."""

from importlib.resources import as_file, files

import numpy as np
from numpy.typing import NDArray

__all__ = ["load_inertial", "load_lidar_radar", "load_odometry", "pack", "unpack"]

Array = NDArray[np.float64]

FULL_SCALE = 32767.0


def pack(values: Array) -> tuple[NDArray[np.int16], float]:
    """Round a series to 16 bits of its range and take differences, which compress well.

    Parameters
    ----------
    values
        Finite numbers, shape (K, columns).

    Returns
    -------
    differences : array of int16
        Shape (columns, K); they wrap around.
    scale
        Value of one count.
    """
    scale = float(np.abs(values).max()) / FULL_SCALE
    counts = np.round(values.T / scale).astype(np.int16)
    return np.diff(counts, axis=1, prepend=np.zeros((len(counts), 1), dtype=np.int16)), scale


def unpack(differences: NDArray[np.int16], scale: float) -> Array:
    """Give back the series that was packed, shape (K, columns)."""
    counts = np.cumsum(differences, axis=1, dtype=np.int16)
    return np.ascontiguousarray(counts.T, dtype=np.float64) * scale


def _read_archive(name: str, wanted: tuple[str, ...]) -> dict[str, NDArray[np.generic]]:
    """Read the arrays of a file of this folder."""
    resource = files(__name__) / name
    if not resource.is_file():
        raise FileNotFoundError(f"{name} must be in the package, beside {__name__}")
    with as_file(resource) as path, np.load(path, allow_pickle=False) as archive:
        missing = [key for key in wanted if key not in archive]
        if missing:
            raise ValueError(f"{name} must hold {', '.join(wanted)}, not without {missing!r}")
        return {key: np.asarray(archive[key]) for key in wanted}


def load_inertial() -> dict[str, Array]:
    """Read the recorded inertial and magnetic data with optical ground truth.

    Returns
    -------
    dict
        ``gyroscope`` (K, 3) in rad/s, ``accelerometer`` (K, 3) in m/s^2, ``magnetometer`` (K, 3)
        in microtesla, ``truth`` (K, 4): quaternion from the body to the east-north-up frame,
        scalar first, NaN where the cameras lost the body; ``movement`` (K,): 1 in the phase
        that errors are computed of; ``rate`` (): samples a second.

    Raises
    ------
    FileNotFoundError
        If the file is not there.
    ValueError
        If it is not what it should be.
    """
    series = ("gyroscope", "accelerometer", "magnetometer", "truth")
    scales = tuple(f"{name}_scale" for name in series)
    found = _read_archive("inertial.npz", (*series, *scales, "movement", "rate"))
    data = {
        name: unpack(found[name].astype(np.int16), float(found[scale]))
        for name, scale in zip(series, scales, strict=True)
    }
    data["movement"] = found["movement"].astype(np.float64)
    data["rate"] = found["rate"].astype(np.float64)
    lengths = {name: len(data[name]) for name in (*series, "movement")}
    if len(set(lengths.values())) != 1:
        raise ValueError(f"inertial.npz must hold series of one length, not {lengths!r}")
    norm = np.linalg.norm(data["truth"], axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        data["truth"] = np.where(norm > 0.5, data["truth"] / norm, np.nan)
    return data


def load_odometry() -> dict[str, Array]:
    """Read the recorded odometry of a robot with optical ground truth.

    Returns
    -------
    dict
        ``times`` (K,) in s; ``gyroscope`` (K,), rate about the vertical, in rad/s; ``speeds``
        (K, 2), forward and lateral, in m/s; ``truth`` (K, 3): heading in rad, x and y in m.

    Raises
    ------
    FileNotFoundError
        If the file is not there.
    ValueError
        If it is not what it should be.
    """
    wanted = ("times", "gyroscope", "speeds", "truth")
    found = _read_archive("odometry.npz", wanted)
    data = {name: found[name].astype(np.float64) for name in wanted}
    lengths = {name: len(values) for name, values in data.items()}
    if len(set(lengths.values())) != 1:
        raise ValueError(f"odometry.npz must hold series of one length, not {lengths!r}")
    return data


def load_lidar_radar() -> tuple[list[str], Array, Array, Array]:
    """Read the records of a lidar and a radar that take turns.

    Returns
    -------
    sensors
        "lidar" or "radar", K of them.
    times
        Shape (K,), in s, from the first record on.
    measurements
        Shape (K, 3). Of the lidar: x and y in m, NaN. Of the radar: range in m, bearing in rad,
        range rate in m/s.
    truth
        Shape (K, 4): x and y in m and their rates in m/s.

    Raises
    ------
    FileNotFoundError
        If the file is not there.
    ValueError
        If a line is not a record.
    """
    name = "lidar_radar.txt"
    resource = files(__name__) / name
    if not resource.is_file():
        raise FileNotFoundError(f"{name} must be in the package, beside {__name__}")
    sensors: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(resource.read_text(encoding="ascii").splitlines(), start=1):
        kind, *texts = line.split()
        if (kind, len(texts)) not in (("L", 9), ("R", 10)):
            raise ValueError(f"Line {number} of {name} must be a record, not {line!r}")
        values = [float(text) for text in texts]
        if kind == "L":
            values.insert(2, np.nan)
        sensors.append("lidar" if kind == "L" else "radar")
        rows.append(values)
    table = np.array(rows)
    times = (table[:, 3] - table[0, 3]) * 1e-6
    return sensors, times, table[:, :3].copy(), table[:, 4:8].copy()
