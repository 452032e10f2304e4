"""Conversion of recorded data."""

import numpy as np
import pytest

from ukf_docs.convert import convert_inertial, convert_odometry
from ukf_sw.problems import data


def test_odometry_is_converted(documents, tmp_path, monkeypatch):
    table = np.random.default_rng(1).standard_normal((20, 7))
    np.savetxt(tmp_path / "raw.txt", table, header="t gyro vx vy theta px py", comments="")
    assert "odometry.npz" in documents("convert", "odometry", "raw.txt", "odometry.npz").stdout
    monkeypatch.setattr(data, "files", lambda package: tmp_path)
    found = data.load_odometry()
    np.testing.assert_allclose(found["times"], table[:, 0], rtol=1e-15)
    np.testing.assert_allclose(found["gyroscope"], table[:, 1], rtol=1e-7)
    np.testing.assert_allclose(found["speeds"], table[:, 2:4], rtol=1e-7)
    np.testing.assert_allclose(found["truth"], table[:, 4:], rtol=1e-7)
    (tmp_path / "other.txt").write_text("a b c\n1 2 3\n")
    with pytest.raises(ValueError, match=r"^other\.txt must start with t gyro .*, not \['a', 'b'"):
        convert_odometry(tmp_path / "other.txt", tmp_path / "x.npz")
    assert (
        "none.txt: No such file" in documents("convert", "odometry", "none.txt", "x", code=1).stderr
    )


def test_inertial_data_are_converted(tmp_path, monkeypatch):
    io = pytest.importorskip("scipy.io")
    rng = np.random.default_rng(2)
    truth = rng.standard_normal((30, 4))
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    truth[5] = np.nan
    raw = {
        "imu_gyr": rng.standard_normal((30, 3)), "imu_acc": 9.0 * rng.standard_normal((30, 3)),
        "imu_mag": 40.0 * rng.standard_normal((30, 3)), "opt_quat": truth,
        "movement": np.arange(30)[:, None] > 9, "sampling_rate": 100.0,
    }  # fmt: skip
    io.savemat(tmp_path / "raw.mat", raw)
    convert_inertial(tmp_path / "raw.mat", tmp_path / "inertial.npz")
    monkeypatch.setattr(data, "files", lambda package: tmp_path)
    found = data.load_inertial()
    np.testing.assert_allclose(found["gyroscope"], raw["imu_gyr"], atol=1e-4)
    np.testing.assert_allclose(found["accelerometer"], raw["imu_acc"], atol=1e-3)
    np.testing.assert_allclose(found["magnetometer"], raw["imu_mag"], atol=4e-3)
    np.testing.assert_allclose(found["truth"], truth, atol=1e-4)
    assert found["movement"].tolist() == [0.0] * 10 + [1.0] * 20
    assert float(found["rate"]) == 100.0
    io.savemat(tmp_path / "raw.mat", {"imu_gyr": raw["imu_gyr"]})
    with pytest.raises(ValueError, match=r"^raw\.mat must hold .*, not without \['imu_acc'"):
        convert_inertial(tmp_path / "raw.mat", tmp_path / "x.npz")


def test_kinds_have_names(documents):
    message = "KIND must be one of inertial, odometry, not 'photo'"
    assert message in documents("convert", "photo", "a", "b", code=2).stderr
