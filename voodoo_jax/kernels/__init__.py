"""Pure functions of one frame and one body: no batch axes, no input or output. `vmap` and `scan` live outside.

Where all points pass (assignment, correspondences, frustum), vectors are taken apart into components: that is several
times faster than products over an axis of length 3. Short lists (bands, features, limbs) are written as plain vectors.
"""
