"""Pure functions of one frame and one body: no batch axes, no input or output. `vmap` and `scan` live outside.

Inside, vectors are taken apart into components: sums by component are several times faster than products over an
axis of length 3 (measured in experiments/bench).
"""
