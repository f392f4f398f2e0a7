"""The tracker of named points alone, such as optical markers: names, gaps, exchanges, sizes, solve, residuals."""
