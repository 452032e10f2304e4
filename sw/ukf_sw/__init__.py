"""Software side of the UKF core: parameters, golden model, driver, filter and system models."""

__version__ = "0.1.0"
