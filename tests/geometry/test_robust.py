"""Geman and McClure's loss: the forms agree with each other and with SciPy's derivative."""

import numpy as np
from scipy.optimize import approx_fprime

from voodoo_jax.geometry.robust import geman_mcclure, geman_mcclure_root


def loss(square, scale):
    return square / (1 + square / scale**2)


def test_weight_is_the_derivative_of_the_loss():
    for square in (0.01, 0.3, 4.0):
        slope = approx_fprime(np.array([square]), lambda s: loss(s[0], 0.7), 1e-7)[0]
        np.testing.assert_allclose(geman_mcclure(square, 0.7), slope, rtol=1e-5)


def test_forms_agree():
    gap = np.array([0.3, -0.2, 0.9])
    square = float(gap @ gap)
    shorter = gap * np.sqrt(geman_mcclure_root(square, 0.4))
    np.testing.assert_allclose(shorter @ shorter, loss(square, 0.4))
    assert geman_mcclure(0.4**2, 0.4) == 0.25 and geman_mcclure(square, np.inf) == 1
