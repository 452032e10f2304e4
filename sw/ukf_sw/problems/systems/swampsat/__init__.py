"""Attitude estimation of SwampSat, a picosatellite with a distributed computing platform.

The application of Asundi, Latchman and Fitz-Coy, "Attitude estimation for picosatellites with
distributed computing platform using Murrell's algorithm of the extended Kalman filter". Equation
numbers in this package are those of that paper.

Quaternions are (q1, q2, q3, q4), scalar last; A(q) = C_BI turns inertial into body components
(equation 4). As Hamilton quaternions they turn from the body to the inertial frame, as in
:mod:`ukf_sw.problems.systems.nanosat`, whose products and errors are used here.

Where the paper is ambiguous or wrong, this follows readings that reproduce its results:

- Eccentricity 0.0007944 instead of 0.07944, whose perigee lies below ground.
- Equations 5 and 8 with C_BI instead of its transpose, with which the filter diverges.
- Equation 15: in Phi_12 the last cross product matrix and the norm below the first term are
  squared; the signs of the correlation of angle and bias are counted once.
- The quaternion is normalised after equation 11.
- "5% of the magnitude" is a standard deviation of 0.05 about each axis of a unit vector; the gyro
  drift covariance is a standard deviation of 2.4 degrees per second.

Field and Sun come from ppigrf and pyerfa, the link's simulation from SimPy:
``pip install 'ukf-core[apps]'``.
"""
