"""The robust loss of Geman and McClure (1985), d^2 / (1 + d^2 / s^2), in the forms in which solvers take it.

Plain arithmetic: arrays of NumPy and of JAX pass alike.
"""


def geman_mcclure(square, scale):
    """Weight of a pair `square` (distance squared) apart: 1 at none, a quarter at `scale` apart; shapes broadcast.

    The loss's derivative by the square, for iteratively reweighted least squares. A ratio, so that an infinite scale
    gives exactly one.
    """
    return geman_mcclure_root(square, scale) ** 2


def geman_mcclure_root(square, scale):
    """Root of the weight: what the rows of a residual and of its Jacobian are multiplied by.

    A residual times the root of this one has the loss as its square.
    """
    return 1 / (1 + square / scale**2)
