"""Files at the rim of the program: sensor logs in, results out. The readers here never import JAX."""
