"""Decides the use of each topic of a log, and which colour images are used."""

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.geometry import lens
from voodoo_jax.io.as_shown import compared
from voodoo_jax.io.calibrations import bare, calibration_of, camera_of, fitted, rectified
from voodoo_jax.io.container import LogError
from voodoo_jax.io.decode.image_codec import COLOUR_KIND
from voodoo_jax.io.decode.registry import DEPTH_KINDS, FEATURE_KINDS
from voodoo_jax.io.point_labels import label_field
from voodoo_jax.io.stereo_pairs import STEREO_USE, Pair, picture_of
from voodoo_jax.io.topic import DEPTH_USES, Problem, Topic, Unused
from voodoo_jax.records.messages import DEPTH_ENCODINGS, RAYS, Calibration, Colour, Image

_GREY = ("mono8", "8uc1")
UNSEARCHED = "Skin detection leaves out '{}': {}."
UNSEEN = "The images of '{}' are not used: {}."


def decide_uses(
    path: str, topics: dict[str, Topic], settings: ReadSettings, notes: list[str], pairs: list[Pair]
) -> dict[str, str]:
    """The use of each topic, or "not used: <reason>"; a camera with both image and cloud is used once.

    Raises LogError if a topic that `settings` name is not in the log.
    """
    uses = {}
    for name, topic in topics.items():
        uses[name] = topic.kind if topic.kind in ("calibration", "transforms") else Unused.because(topic.why_not)
        if topic.kind in DEPTH_KINDS:
            uses[name] = _depth_use(topics, name)
        elif topic.kind == COLOUR_KIND:
            uses[name] = _empty(topic) or _picture(name, topic)
    none, place = compared(topics, [n for n, use in uses.items() if use == "depth image"])
    uses |= {name: Unused.because(why, Problem.NO_DEPTH) for name, why in none.items() if name not in settings.topics}
    for pair in pairs:
        rig = [n for n, use in uses.items() if use in ("depth image", "point cloud") and n.startswith(pair.rig)]
        if pair.problem:
            known = all(calibration_of(topics, name) for name in (pair.left, pair.right))
            uses[pair.left] = Unused.because(f"a stereo pair, but {pair.problem}", Problem.STEREO if known else None)
        elif rig and pair.left not in settings.topics:
            uses[pair.left] = Unused.because(f"a stereo pair, but '{rig[0]}' gives the depth of its rig")
        else:
            uses[pair.left], uses[pair.right] = STEREO_USE, f"right image of '{pair.left}'"
    for name, topic in topics.items():  # after the depth sensors, whose calibrations are not for features
        if topic.kind in FEATURE_KINDS:
            uses[name] = _feature_use(topics, name)
    if settings.topics:
        depth = [name for name, use in uses.items() if use in DEPTH_USES]
        for name in settings.topics:
            if name not in depth:
                why = f" ({uses[name]})" if name in uses else ""
                raise LogError(f"'{path}' has no depth topic '{name}'{why}. It has: {', '.join(depth) or 'none'}.")
        return {n: Unused.because("not in read.topics") if n in depth and n not in settings.topics else use
                for n, use in uses.items()}  # fmt: skip
    order = {"depth image": 0, "point cloud": 1}  # a laser scanner shadows nothing
    seen: dict[str, str] = {}
    cut_out = {word.partition("=")[0] for word in settings.parts}  # of what another topic may give as a whole
    labelled = {n for n in uses if uses[n] == "point cloud" and label_field(topics[n].sample, settings)}
    rank = lambda n: (n not in labelled, _is_mono(topics, n), order[uses[n]], place.get(n, 0), n)  # noqa: E731
    ranked = sorted((n for n in uses if uses[n] in order and n not in cut_out), key=rank)
    for name in ranked:
        frame = topics[name].sample.frame
        # Two clouds of one frame may be two sensors given in a common frame, so only images shadow others.
        first = seen.get(frame)
        doubled = first in labelled and uses[name] == "depth image"  # the labels say more
        if first and (doubled or uses[first] == "depth image" or _is_mono(topics, name)):
            uses[name] = Unused.because(f"the same camera as '{first}' (frame '{frame}')")
            notes.append(f"'{name}' is left out: it is the same camera as '{first}' (frame '{frame}').")
        seen.setdefault(frame, name)
    return uses


def _picture(name: str, topic: Topic) -> Unused:
    """What a compressed image without depth is."""
    encoding = topic.sample.encoding if isinstance(topic.sample, Colour) else ""
    depth = encoding.upper().startswith(tuple(DEPTH_ENCODINGS)) or "depth" in name.lower()
    if depth and ("jpeg" in encoding or "jpg" in encoding):
        return Unused.because(
            "depth packed as JPEG, which keeps 8 of its 16 bits and changes these: it cannot be restored. Record "
            f"'{bare(name)}/compressedDepth' or '{bare(name)}' itself",
            Problem.JPEG,
        )
    return Unused.because("a colour image")


def _is_mono(topics: dict[str, Topic], name: str) -> bool:
    sample = topics[name].sample
    return isinstance(sample, Image) and sample.encoding.upper() == "MONO16"


def _empty(topic: Topic) -> Unused | None:
    """Why nothing of a topic can be read; None if something can."""
    if topic.count == 0:
        if topic.stated:
            return Unused.because(f"none of its {topic.stated} messages can be read", Problem.LOST)
        return Unused.because("no messages")
    if topic.sample is None:
        return Unused.because(f"no message can be decoded ({topic.error})", Problem.BROKEN)
    return Unused.because(topic.foreign, Problem.CLOCK) if topic.foreign else None


def _feature_use(topics: dict[str, Topic], name: str) -> str:
    topic, found = topics[name], topics[name].gathered
    if empty := _empty(topic):
        return empty
    if found is None or not found.names:
        return Unused.because("its messages have no names")
    if topic.kind == RAYS:
        cameras = {frame: camera_of(topics, name, frame) for frame in sorted(set(found.frames))}
        if not any(cameras.values()):
            frames = ", ".join(f"frame '{f}'" if f else "its topic" for f in cameras)
            return Unused.because(f"2D features without calibration (none for {frames})", Problem.FEATURES)
        for c in filter(None, cameras.values()):
            try:
                lens.pixel_rays(c.K, c.D, c.model, 2, 2)
            except ValueError as error:
                return Unused.because(f"2D features whose calibration is unusable: {error}", Problem.FEATURES)
    return topic.kind


def _depth_use(topics: dict[str, Topic], name: str) -> str:
    topic = topics[name]
    if empty := _empty(topic):
        return empty
    if topic.kind in ("point cloud", "laser scan"):
        return topic.kind
    if topic.sample.raw is None and topic.sample.packed is None:
        return Unused.because(f"encoding {topic.sample.encoding} is not a depth image")
    tokens = name.lower().replace("/", "_").split("_")
    if _is_mono(topics, name) and {"ir", "infra", "infra1", "infra2", "infrared", "amplitude", "intensity"} & {*tokens}:
        return Unused.because("brightness, by its name")
    calibration = calibration_of(topics, name)
    if calibration is None:
        why = f"a depth image without calibration (none for frame '{topic.sample.frame}')"
        return Unused.because(why, Problem.CALIBRATION)
    try:
        # A small part is enough to learn whether the lens model is known.
        lens.pixel_rays(calibration.K, calibration.D, calibration.model, 2, 2)
        fitted(calibration, topic.sample.shape)
    except ValueError as error:
        return Unused.because(f"a depth image whose calibration is unusable: {error}", Problem.CALIBRATION)
    return "depth image"


def camera_topics(
    topics: dict[str, Topic], uses: dict[str, str], note: str = UNSEEN, of_pairs: bool = False
) -> tuple[dict[str, Calibration], list[str]]:
    """One topic of colour images for each calibrated camera (not compressed, then rectified), and notes on those that
    cannot be used; of stereo pairs in use none, or `of_pairs` the left ones."""
    found: dict[str, tuple[str, Calibration]] = {}
    notes = []
    pictures = {n: picture for n, t in topics.items() if (picture := picture_of(t.sample)) is not None}
    for name in sorted(pictures, key=lambda n: (not pictures[n].step, not rectified(n), n)):
        left, right = uses[name] == STEREO_USE, uses[name].startswith("right image of")
        if pictures[name].encoding in _GREY or right or (left and not of_pairs):
            continue
        c = calibration_of(topics, name)
        try:
            if c is None:
                raise ValueError("it has no calibration")
            lens.pixel_rays(c.K, c.D, c.model, 2, 2)
            found.setdefault(pictures[name].frame or name, (name, c))
        except ValueError as problem:
            notes.append(note.format(name, problem))
    return dict(found.values()), notes
