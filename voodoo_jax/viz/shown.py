"""A figure that notebooks show without pyplot."""

from io import BytesIO

from matplotlib.figure import Figure

DPI = 72  # matplotlib's inline backend's own


class ShownFigure(Figure):
    """A figure without global plot state that shows itself where it is the last value of a notebook's cell."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=DPI)
        return stream.getvalue()
