"""A figure that notebooks show without pyplot."""

from io import BytesIO

from matplotlib.figure import Figure

DPI = 72  # matplotlib's inline backend's own


class ShownFigure(Figure):
    """A figure without global plot state that a notebook shows as the last value of a cell."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=DPI)
        return stream.getvalue()
