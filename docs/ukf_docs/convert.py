"""Conversion of recorded data from the files of their authors to those of the package."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ukf_sw.problems.data import pack

__all__ = ["convert_inertial", "convert_odometry"]


def convert_inertial(source: Path, destination: Path) -> Path:
    """Convert a trial of BROAD, a MATLAB file; needs SciPy.

    Every series is kept at its full rate, rounded to 16 bits of its range: 1.7e-4 rad/s, 4.8e-4
    m/s^2 and 1.4e-3 microtesla, far below the resolution of the sensors (1.1e-3, 4e-3 and 0.075),
    and 0.003 degrees of the truth. Where the truth is unknown, all zeros stand for it.

    Parameters
    ----------
    source
        The file, such as ``01_undisturbed_slow_rotation_A.mat``.
    destination
        File to write.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ValueError
        If the file does not hold such a trial.
    """
    from scipy.io import loadmat

    found = loadmat(source)
    series = {
        "gyroscope": "imu_gyr",
        "accelerometer": "imu_acc",
        "magnetometer": "imu_mag",
        "truth": "opt_quat",
    }
    wanted = (*series.values(), "movement", "sampling_rate")
    missing = [name for name in wanted if name not in found]
    if missing:
        raise ValueError(f"{source.name} must hold {', '.join(wanted)}, not without {missing!r}")
    arrays: dict[str, Any] = {}
    for name, key in series.items():
        values = np.nan_to_num(np.asarray(found[key], dtype=np.float64))
        arrays[name], arrays[f"{name}_scale"] = pack(values)
    arrays["movement"] = found["movement"][:, 0].astype(np.uint8)
    arrays["rate"] = np.asarray(found["sampling_rate"], dtype=np.float64).reshape(())
    return _save(destination, arrays)


def convert_odometry(source: Path, destination: Path) -> Path:
    """Convert a recording of ukfm's robot, a table; it becomes smaller by its text only.

    Parameters
    ----------
    source
        The file, such as ``wifibot2.txt``.
    destination
        File to write.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ValueError
        If the file is not such a table.
    """
    with source.open(encoding="ascii") as file:
        heading = file.readline().split()
        table = np.loadtxt(file)
    if heading != ["t", "gyro", "vx", "vy", "theta", "px", "py"]:
        raise ValueError(f"{source.name} must start with t gyro vx vy theta px py, not {heading!r}")
    arrays = {
        "times": table[:, 0],
        "gyroscope": table[:, 1].astype(np.float32),
        "speeds": table[:, 2:4].astype(np.float32),
        "truth": table[:, 4:7].astype(np.float32),
    }
    return _save(destination, arrays)


def _save(destination: Path, arrays: Mapping[str, Any]) -> Path:
    destination.parent.mkdir(parents=True, exist_ok=True)
    with destination.open("wb") as file:
        np.savez_compressed(file, **arrays)
    return destination
