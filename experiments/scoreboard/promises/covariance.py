"""What joint_covariance is worth."""

import numpy as np

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog

PROMISE = Promise(
    name="covariance",
    sentence="The 95 % regions of joint covariances hold 93 to 97 % of the truth.",
    data="the 18 recordings",
    figures=(Figure("truth inside 95 % regions, off 95 %", 2.5, tolerance=0.5),),
    jobs=lambda data: [TrackLog(log) for log in data.logs()],
    measure=lambda logs: {
        "truth inside 95 % regions, off 95 %": abs(
            100 * float(np.nanmean(np.concatenate([o.inside.ravel() for o in logs]))) - 95
        )
    },
)
