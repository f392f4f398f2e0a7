"""The result of a fit, its judgement by recordings, and its report: Markdown with tables, a figure of the loss, and a
page that shows both and the bodies."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float64

from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.judge import Judged, Verdict
from voodoo_jax.fitting.sizes import Size
from voodoo_jax.model.body import Body
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.viz.report_page import write_fit_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Fit:
    """The result of a fit. `x`, `sd`, `prior_sd` as in Parameters: logarithms of factors, or shares of the scale."""

    body: Body  # of the first person: the fitted body if it is better, else the one before
    bodies: tuple[Body, ...]  # of every person
    fitted: tuple[Body, ...]  # fitted bodies, better or not
    starts: tuple[Body, ...]  # before the fit
    verdict: Verdict
    names: tuple[str, ...]
    x: Float64[np.ndarray, " all"]
    sd: Float64[np.ndarray, " all"]
    spread: Float64[np.ndarray, " all"]  # between parts of the recordings, see gauss_newton.spread
    prior_sd: Float64[np.ndarray, " all"]
    # sizes that the recordings do not determine: a person's usual ones, or as they were
    stays: Bool[np.ndarray, " all"]
    sizes: tuple[tuple[Size, ...], ...]  # of every person: sizes as measured by tape, before and after
    losses: tuple[float, ...]
    finished: bool  # stopped by itself
    judged: tuple[Judged, ...]
    settings: FitSettings
    tuned: Settings  # the settings with the fitted options of the solve and weights of features

    @property
    def better(self) -> bool:
        """Whether the fitted body is better than the one before; if not, `body` is the one before."""
        return self.verdict.better

    @property
    def report(self) -> str:
        """The report as Markdown."""
        return report_text(self)

    def undetermined(self) -> list[str]:
        """Parameters that the data do not determine: a person's lengths are usual ones, others as they were."""
        return [name for name, stays in zip(self.names, self.stays) if stays]


def _format_table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _format_cm(value: float) -> str:
    return f"{100 * value:.2f}" if np.isfinite(value) else "-"


def _format_interval(size: Size) -> str:
    reach = 1.96 * size.sd
    return f"{_format_cm(size.after - reach)} .. {_format_cm(size.after + reach)}" if np.isfinite(reach) else "-"


def _tabulate_errors(judged: Sequence[Judged]) -> list[str]:
    """Errors of points and joints, by recording."""
    rows = []
    for j in judged:
        left_out = j.held.all()
        for word, mask in (("left out", j.held),) if left_out else (("fitted", ~j.held), ("held back", j.held)):
            columns = [v[mask] for v in (j.before, j.after, j.joints_before, j.joints_after)]
            values = [float(np.nanmean(v)) if np.isfinite(v).any() else float("nan") for v in columns]
            rows.append([f"{j.name}, {word}", str(int(np.isfinite(j.after[mask]).sum())), *map(_format_cm, values)])
    head = ["log", "runs of time", "points off, before, cm", "after, cm", "joints off, before, cm", "after, cm"]
    how = "two of three runs of time were held back from the fit, and judge it."
    if judged and judged[0].held.all():
        how = "each log was left out of the fit that it judges."
    text = f"The whole log, tracked with the body before and with the fitted body; {how}\n"
    return ["## Before and after\n", text, _format_table(head, rows)]


def report_text(fit: Fit) -> str:
    """The report as Markdown."""
    out = ["# Fit of a body\n", fit.verdict.why + "\n"]
    ended = "stopped by itself" if fit.finished else "was ended by its limit of steps: more may gain something"
    out.append(f"{len(fit.losses) - 1} steps, loss {fit.losses[0]:.1f} to {fit.losses[-1]:.1f}; it {ended}.\n")
    out += _tabulate_errors(fit.judged)
    if fit.sizes:
        out.append("## Sizes\n")
        out.append(
            "Girths are those of the body's cylinders half way along a limb. The intervals follow from the model and "
            "its noise; they leave out that people are not cylinders.\n"
        )
    for k, sizes in enumerate(fit.sizes):
        if len(fit.fitted) > 1:
            names = ", ".join(j.name for j in fit.judged if j.person == k)
            out.append(f"### Person {k + 1} ({names})\n")
        rows = [[s.name, _format_cm(s.before), _format_cm(s.after), _format_interval(s)] for s in sizes]
        out.append(_format_table(["size", "before, cm", "fitted, cm", "95 % interval, cm"], rows))
    rows = []
    for name, x, sd, apart, prior, stays in zip(fit.names, fit.x, fit.sd, fit.spread, fit.prior_sd, fit.stays):
        interval, parts, share = "-", "-", "-"
        unit = 1.0 if name.startswith("shape.") else 100.0
        if np.isfinite(sd):
            interval = f"{unit * (x - 1.96 * sd):+.1f} .. {unit * (x + 1.96 * sd):+.1f}"
            parts, share = f"{unit * apart:.1f}", f"{100 * (1 - (sd / prior) ** 2):.0f} %"
        rows.append(
            [name, "stays" if stays and not x else f"{unit * x:+.1f}", interval, f"{unit * prior:.1f}", parts, share]
        )
    out.append("## Parameters\n")
    out.append(
        "Changes in percent (logarithms times 100; anchors: percent of the scale), of shape in standard deviations of "
        "people (the [[mode]] tables of the body file). The intervals follow from the Gauss-Newton matrix with the "
        "priors: from the model and its noise. They leave out that people are not cylinders. Between parts: standard "
        "deviation of a change between parts of the logs. From the data: share of the data in the information on a "
        "parameter.\n"
    )
    head = ["parameter", "change", "95 % interval", "prior's deviation", "between parts", "from the data"]
    out.append(_format_table(head, rows))
    if weak := fit.undetermined():
        out.append(
            f"The data say too little about: {', '.join(weak)}. These parameters keep their start values; lengths of a "
            "person are the usual ones at the stature, or those measured between the tracked joints.\n"
        )
    return "\n".join(out)


def write_report(fit: Fit, path: str | os.PathLike[str]) -> tuple[Path, Path, Path]:
    """Writes the report as `path` (.md), a figure of loss and parameters (.png), and a page with both (.html).
    Returns their paths."""
    text, drawn, page = (Path(path).with_suffix(end) for end in (Path(path).suffix, ".png", ".html"))
    report = report_text(fit)
    with replacing(text) as partial:
        partial.write_text(report + f"\n![loss and parameters]({drawn.name})\n", encoding="utf-8")
    with replacing(drawn) as partial:
        _draw(fit).savefig(partial, format="png", dpi=100)
    write_fit_page(report, list(zip(fit.starts, fit.fitted)), drawn.read_bytes(), page)
    return text, drawn, page


def _draw(fit: Fit) -> "Figure":
    """Loss over steps, and parameters with their intervals."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 0.16 * max(len(fit.names), 16) + 1), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(fit.losses, "o-")
    left.set(xlabel="step", ylabel="loss", title="loss")
    rows = np.arange(len(fit.names))
    right.barh(rows, 2 * 1.96 * fit.prior_sd, left=-1.96 * fit.prior_sd, color="0.9", label="prior, 95 %")
    sd = np.nan_to_num(fit.sd)
    right.errorbar(fit.x, rows, xerr=1.96 * sd, fmt="o", ms=3, lw=1, label="fit, 95 %")
    right.set_yticks(rows, fit.names, fontsize=6)
    right.set(title="parameters (logarithms; shares of the scale)")
    right.invert_yaxis()
    right.legend(fontsize=7)
    return figure
