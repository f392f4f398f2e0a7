"""Settings by name: the defaults, the values of Knoop 2007, and those without a look into the future."""

from dataclasses import replace

from voodoo_jax.config.options import (
    LOOKS_AHEAD,
    DetectSettings,
    FeatureSettings,
    FlexibleSettings,
    ReadSettings,
    Settings,
    SettingsError,
    SolveSettings,
    TrackSettings,
)


def preset(name: str) -> Settings:
    """Settings by name: "default"; "knoop2007", the chain and the values of Knoop 2007 as far as it gives them;
    "flexible", the defaults of the flexible tracker; "both", those of both trackers together; "hecht2009", the system
    of Hecht, Azad and Dillmann 2009.

    Those of papers do not follow the defaults. Where a paper names a parameter and no value (2007: enlargements,
    longest distance, point reduction, epsilon; 2009: weights, thresholds, what hidden samples score) a usual one is
    here. The body of "knoop2007" is the built-in "human10". Raises SettingsError.
    """
    if name == "default":
        return Settings()
    if name == "flexible":
        return Settings(tracker="flexible", read=_IMAGES)
    if name == "both":
        return Settings(tracker="both", read=ReadSettings(images=True))
    if name == "hecht2009":
        return Settings(tracker="flexible", read=_IMAGES, flexible=_hecht2009())
    if name != "knoop2007":
        raise SettingsError(f"there is no preset '{name}'; there are {', '.join(PRESETS)}")
    inf = float("inf")
    return Settings(
        read=ReadSettings(laser=True),
        detect=DetectSettings(noise=0.0),
        features=FeatureSettings(
            # sec. 7
            weights=("face=30", "left_hand=20", "right_hand=20", "skin=20"), weight=20.0, robust_scale=inf,
            max_distance=inf,
        ),
        solve=SolveSettings(
            solver="per_limb", damping=0.0,
            max_steps=6,  # sec. 7: a good trade-off between time and accuracy
            epsilon=1e-7,
            ratio=0.55, floor=0.0,  # sec. 4.3: 0.4 < r < 0.7, of the limb's own measurements
            body_enlarge=0.2, limb_enlarge=0.1, max_distance=0.25, robust_scale=inf,
            overlap="exclusive",  # sec. 3.2: to the geometrically closest body part
            sampling=0.5, sampling_min=50, sampling_max=200,
            near_side=False, refine=4,
            prior=1e-6, prior_radius=0.4,  # next to nothing: keeps a limb where it is that nothing was measured of
            limits=0.0, collisions=0.0,
        ),
        # sec. 5.2: each frame starts from the last one's pose; nothing of ours but the start
        track=TrackSettings(damping=0.0, skip=(LOOKS_AHEAD, "place_joints")),
    )  # fmt: skip


def _hecht2009() -> FlexibleSettings:
    return FlexibleSettings(
        particles=200, head_particles=100, hypotheses=1,  # sec. IV-A
        layers=1, velocity=0.65,  # sec. III-A: 50 % to 80 %
        depth_share=0.25, depth_noise=(0.15, 0.5, 1.0),  # sec. III-A
        # named there, without values: the best of some 20 choices on half of the stereo logs (experiments/flexible)
        base_noise=0.02, spread_noise=0.2, motion_noise=0.03,
        edge_weight=12.0, surface_weight=12.0, depth_weight=0.0, points_weight=0.0,  # sec. III-B: two scores
        # "chosen carefully" there, to prefer neither what is seen nor what is not: below the scores of limbs in place
        hidden_edge=0.2, hidden_surface=0.3, unseen=0.0,
        skin_weight=0.0, seen_length=False, refine=0,
        follow_level=0.8, follow_up=0.8,  # sec. III: 80 %
        legs_apart=0.02, legs_cross=0.0,  # sec. IV-B: a plane that keeps natural cross-overs out
        backwards=False,
    )  # fmt: skip


PRESETS = ("default", "knoop2007", "flexible", "both", "hecht2009")
_IMAGES = ReadSettings(images=True, matching="none")  # what the flexible tracker reads


def online(settings: Settings, lag: float = 0.0) -> Settings:
    """Settings that use no later frames, except for the half second after each start, in which starts and sizes are
    compared.

    **Arguments:** `lag` seconds by which results may be late: that much of what follows a frame is used as well.
    """
    return replace(settings, online=True, online_lag=lag or settings.online_lag)
