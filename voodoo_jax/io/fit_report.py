"""The report of a fit: Markdown with tables, and a figure of the loss."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from voodoo_jax.body import segment_lengths
from voodoo_jax.io.atomic import replacing

if TYPE_CHECKING:
    from voodoo_jax.fit_body import Fit, Judged


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cm(value: float) -> str:
    return f"{100 * value:.2f}" if np.isfinite(value) else "-"


def verdict(judged: "tuple[Judged, ...]") -> str:
    """Whether the fit helps in frames that it has not seen: a plain sentence."""
    both = [(j.joints_before, j.joints_after) for j in judged]
    known = any(np.isfinite(a[j.held]).any() for j, (a, _) in zip(judged, both))
    pairs = both if known else [(j.before, j.after) for j in judged]
    before, after = (np.concatenate([p[k][j.held] for j, p in zip(judged, pairs)]) for k in (0, 1))
    there = np.isfinite(before) & np.isfinite(after)
    what = "mean joint error" if known else "distance of the judging measurements"
    if there.sum() < 3:
        return "Too few held-out frames came to rest to say whether the fit helps."
    change = after[there] - before[there]
    spread = 2 * float(change.std(ddof=1)) / np.sqrt(there.sum())
    size = f"{_cm(float(before[there].mean()))} to {_cm(float(after[there].mean()))} cm ({what}, {there.sum()} frames)"
    if change.mean() < -spread:
        return f"In frames that were held out the fit helps: {size}."
    if change.mean() > spread:
        return f"In frames that were held out the fit does harm: {size}. Better keep the body as it was."
    return f"In frames that were held out the fit makes no clear difference: {size}."


def report_text(fit: "Fit") -> str:
    """The report as Markdown."""
    out = ["# Fit of a body\n", verdict(fit.judged) + "\n"]
    rest = sum(int(np.isfinite(j.after).sum()) for j in fit.judged)
    frames = sum(len(j.after) for j in fit.judged)
    ended = "stopped by itself" if fit.finished else "was ended by its limit of steps: more may gain something"
    out.append(
        f"{len(fit.losses) - 1} steps, loss {fit.losses[0]:.1f} to {fit.losses[-1]:.1f}; it {ended}. "
        f"{rest} of {frames} frames came to rest before and after; the others count nothing.\n"
    )
    rows = []
    for j in fit.judged:
        for word, mask in (("fitted", ~j.held), ("held out", j.held)):
            columns = [v[mask] for v in (j.before, j.after, j.joints_before, j.joints_after)]
            values = [float(np.nanmean(v)) if np.isfinite(v).any() else float("nan") for v in columns]
            rows.append([f"{j.name}, {word}", str(int(np.isfinite(j.after[mask]).sum())), *map(_cm, values)])
    head = ["frames", "at rest", "before, cm", "after, cm", "joints before, cm", "joints after, cm"]
    out += ["## Before and after\n", _table(head, rows)]
    for k, (start, body) in enumerate(zip(fit.starts, fit.bodies)):
        if len(fit.bodies) > 1:
            names = ", ".join(j.name for j in fit.judged if j.person == k)
            out.append(f"### Person {k + 1} ({names})\n")
        was, now = segment_lengths(start), segment_lengths(body)
        rows = [[start.scale_name, _cm(float(start.scale)), _cm(float(body.scale))]]
        rows += [[name, _cm(was[name]), _cm(now[name])] for name in was]
        out.append(_table(["length", "before, cm", "after, cm"], rows))
    rows = []
    for name, x, sd, prior in zip(fit.names, fit.x, fit.sd, fit.prior_sd):
        share = "not determined" if sd > 0.9 * prior else "partly" if sd > 0.6 * prior else "yes"
        interval = f"{100 * (x - 1.96 * sd):+.1f} .. {100 * (x + 1.96 * sd):+.1f}" if np.isfinite(sd) else "-"
        rows.append([name, f"{100 * x:+.1f}", interval, f"{100 * prior:.1f}", share if np.isfinite(sd) else "-"])
    out.append("## Parameters\n")
    out.append(
        "Changes in percent (logarithms times 100; anchors: percent of the scale). The intervals are those of the "
        "Gauss-Newton matrix with the priors: what the model and its noise allow. That a person is no cylinder is not "
        "in them.\n"
    )
    out.append(_table(["parameter", "change", "95 % interval", "prior's deviation", "determined by the data"], rows))
    weak = fit.undetermined()
    if weak:
        out.append(f"The data say next to nothing about: {', '.join(weak)}. Their values are the priors'.\n")
    return "\n".join(out)


def write_report(fit: "Fit", path: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Writes the report as `path` (.md) and a figure of loss and parameters beside it (.png); their paths."""
    from matplotlib.figure import Figure

    text, drawn = Path(path), Path(path).with_suffix(".png")
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
    with replacing(text) as partial:
        partial.write_text(report_text(fit) + f"\n![loss and parameters]({drawn.name})\n", encoding="utf-8")
    with replacing(drawn) as partial:
        figure.savefig(partial, format="png", dpi=100)
    return text, drawn
