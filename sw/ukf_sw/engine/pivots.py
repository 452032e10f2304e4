"""When a pivot of the observation is rounding noise, and what it is compared with.

Before its elimination the squared norm of row i of the whitened observation is d_i plus the sum of
L_ij^2 over the rows before it. A row that depends on them should leave d_i = 0 and leaves rounding
errors. So a pivot is noise if it is smaller than its largest L_ij^2 by more than rounding explains.
The exponents of both are enough to tell, and they pass over the scalar bus anyway.
"""

from ukf_sw.spec.parameters import Form, UkfParams

__all__ = ["noise_exponent"]


def noise_exponent(params: UkfParams) -> int:
    """Give k: a pivot d is noise if floor(log2 d) < 2 floor(log2 L) - k, L the largest |L_ij|.

    Measured in binary32 with 2 to 23 observations and 1 to 15 states, for rows that depend on
    others and for noise that is a small part of H P H^T, 2 floor(log2 L) - floor(log2 d) is

    ===========  ================================  ==================================  ===
    form         row depends on others             noise                               k
    ===========  ================================  ==================================  ===
    square-root  mostly at least 42                at most 32 with 1e-10 of H P H^T     36
    covariance   mostly at least 20, or negative   at most 17 with 4e-6 of H P H^T      18
    ===========  ================================  ==================================  ===

    Mostly: where a row before it was itself left small, its rounding errors are larger. Of 600
    random H with more rows than states and R = 0, 3 pass for regular in the square-root form, as
    many as in the float64 reference. In the covariance form none does, but in 16 the negative pivot
    that rounding leaves is met in a row of the state.
    """
    precision = params.format.precision
    if params.form is Form.SQUARE_ROOT:
        # The inner product of a residual row with itself: the rounding errors are squared too.
        return 2 * precision - 8 - precision // 6
    return max(precision - params.N.bit_length() - 2, 2)
