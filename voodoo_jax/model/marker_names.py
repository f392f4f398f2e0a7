"""The point of the body for each name of a marker or key point: sets of names as data files, and rules to read names.

A set is a TOML file in `model/marker_files`: `title`, `source`, perhaps `weight` (of each of its points as a feature),
perhaps `hips = "newington"` (its model's hip centres are by that regression), and two tables of names and places.
`[middle]` holds names of the body's middle, `[sides]` names without their side, `[numbers]` what the numbers of systems
stand for that give their points no names. A name is a regular expression for the
whole name in small letters, without separators; a place is a feature point or a joint centre of the body without `l_`
and `r_`, or a limb: somewhere on it. `place~0.05`: metres by which it may lie off (one standard deviation), where that
is more than usual.
"""

import re
import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from itertools import permutations

from voodoo_jax.config.options import FeatureSettings
from voodoo_jax.config.toml import check_pairs
from voodoo_jax.model.marker_sets import V1_NAMES

LEAST = 5  # names of a set that must be there for it to be believed
SHARE = 0.15  # of the names: a second set explains at least so many, or is chance
SUBJECT = 6  # names with one prefix that make a subject of their own
REORDERED = 3  # words of a name beside its side that are tried in other orders; by hand
# share of the names that two subjects have in common, and of a set's numbers that are there at least; by hand
ALIKE = 0.5
_SIDES = {"l": "l", "left": "l", "r": "r", "right": "r"}
_NO_MEANING = {"study", "marker", "mkr", "static", "kp", "keypoint"}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z][a-z]*|[a-z]+|\d+")
# a side behind capitals or a number: ASISr, STERl, D1Ml
_SIDE_BEHIND = re.compile(r"(.*[A-Z0-9])([lr])")
# what systems call points that nobody named: "*12", "C_7", "Unlabeled 3", "x52", "M012", bare numbers; not C7
_NOBODY = re.compile(
    r"\W*(unl\w*|unknown|unnamed|untitled|mkr|marker|trajectory)?[\W_]*\d+|[cmux]([\W_]+\d+|\d{2,})", re.IGNORECASE
)

# a net's word for its points, perhaps how many there are, and a number; bare numbers may be anybody's
_COUNTED = re.compile(
    r"(.*(?:landmark|key_?point|kpt?|joint|skeleton|pose|coco|body_25|blazepose|mediapipe|openpose)s?(?: of (\d+))?)"
    r"[\W_]*(\d+)",
    re.IGNORECASE,
)
JOINT = "joint of {}/"  # what a point without a name is called, of so many, before its number


@dataclass(frozen=True)
class MarkerSet:
    """Names of one system. `find` looks a name up."""

    title: str
    weight: float | None  # of each point as a feature; None: as usual
    middle: tuple[tuple[re.Pattern, str], ...]
    sides: tuple[tuple[re.Pattern, str], ...]
    numbered: tuple[str, ...]  # names that numbers stand for, of several bodies: 100 times the body's and the point's
    numbers: Mapping[str, tuple[str, ...]]  # names that numbers stand for, of systems with so many points each
    newington: bool  # whether its hips are defined by the Newington regression

    def find(self, name: str, there: Collection[str] | None = None) -> str | None:
        """Place of a name without the subject's: a point or limb of those `there` (None: any), perhaps with "~" and
        metres behind.

        What has a side may sit on a limb or at a point of the middle.
        """
        for side, stem in readings(name):
            table = self.sides if side else self.middle
            place = next((place for pattern, place in table if pattern.fullmatch(stem)), None)
            for full in (f"{side}_{place}", place) if side and place else (place,):
                if full is not None and (there is None or split_place(full)[0] in there):
                    return full
        return None


@dataclass(frozen=True)
class Known:
    """Meanings of a subject's names."""

    places: dict[str, str] = field(default_factory=dict)  # by full name: a point or limb, perhaps "~" and metres
    titles: tuple[str, ...] = ()  # of the sets that they are of, the one with the most names first
    weights: dict[str, float] = field(default_factory=dict)  # by full name, where a set says it
    unknown: tuple[str, ...] = ()  # names that no set knows
    newington: bool = True  # whether hips are where Plug-in Gait has them; else see harrington_hips


def readings(name: str) -> list[tuple[str, str]]:
    """Ways to read a name: side ("l", "r", or "" for none) and the rest in small letters without separators."""
    behind = _SIDE_BEHIND.fullmatch(name)
    words = [w.lower() for w in _WORD.findall(f"{behind[1]} {behind[2]}" if behind else name)]
    words = [w for w in words if w not in _NO_MEANING] or words
    flat = "".join(words)
    found, others = [("", flat)], []
    for i, word in enumerate(words):
        if side := _SIDES.get(word):
            rest = words[:i] + words[i + 1 :]
            found.append((side, "".join(rest)))
            if 1 < len(rest) <= REORDERED:  # MalleolusLateral for LateralMalleolus
                others += [(side, "".join(order)) for order in permutations(rest)][1:]
    for mark, side in (("left", "l"), ("right", "r"), ("l", "l"), ("r", "r")):
        if flat.startswith(mark):
            found.append((side, flat[len(mark) :]))
        if len(mark) > 1 and flat.endswith(mark):
            found.append((side, flat[: -len(mark)]))
    return found + others


def nobodys(name: str) -> bool:
    """Whether a name is a number that a system gave to an unnamed point."""
    return _NOBODY.fullmatch(name) is not None


@lru_cache(maxsize=1)
def marker_sets() -> tuple[MarkerSet, ...]:
    """All sets that come with the package, in the order of their file names."""
    folder = resources.files("voodoo_jax.model.marker_files")
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    return tuple(_parsed(f.read_text(encoding="utf-8")) for f in files)


def _parsed(text: str) -> MarkerSet:
    content = tomllib.loads(text)
    table = lambda key: tuple((re.compile(name), place) for name, place in content.get(key, {}).items())  # noqa: E731
    numbered, newington = tuple(content.get("numbered", ())), content.get("hips") == "newington"
    numbers = {system: tuple(names) for system, names in content.get("numbers", {}).items()}
    numbers |= {content["title"]: numbered} if numbered else {}
    one = content["title"], content.get("weight"), table("middle"), table("sides")
    return MarkerSet(*one, numbered, numbers, newington)


@lru_cache(maxsize=16)  # asked of each message without names
def orders(count: int) -> dict[str, tuple[str, ...]]:
    """Names of the points of all systems with this number of points, which only their order identifies."""
    tables = (one.numbers.items() for one in marker_sets())
    return {system: names for some in tables for system, names in some if len(names) == count}


def numbered_names(count: int) -> tuple[str, ...] | None:
    """The names of the first system with this number of points; None: no such system is known."""
    return next(iter(orders(count).values()), None)


def split_place(place: str) -> tuple[str, float | None]:
    """A place without its "~", and the metres behind it."""
    point, _, metres = place.partition("~")
    return point, float(metres) if metres else None


def subjects(names: Iterable[str]) -> dict[str, dict[str, str]]:
    """Names by subject, each with the rest of the name: LASI of "Anna:LASI", "Anna/LASI" and, if most names begin so,
    "Anna_LASI". One subject if the names do not separate several."""
    names = list(dict.fromkeys(names))
    found: dict[str, dict[str, str]] = {}
    for name in names:
        subject, mark, rest = name.rpartition(":")
        if not mark and not name.rpartition("/")[2].isdigit():
            subject, mark, rest = name.rpartition("/")
        found.setdefault(subject if rest else "", {})[name] = (rest or name).strip()
    few = {n: rest for s, group in found.items() if len(group) < SUBJECT for n, rest in group.items()}
    found = {s: group for s, group in found.items() if len(group) >= SUBJECT}
    if not found:
        found = {"": few}
    elif few:
        largest = max(found, key=lambda s: len(found[s]))
        found[largest] = {n: r for n, r in (found[largest] | few).items()}
    return {s: g for subject, group in found.items() for s, g in _prefixed(subject, group).items()}


def _prefixed(subject: str, names: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """The same with another separator between subject and name."""
    numbers = _numbered(names)
    if numbers:
        return numbers
    groups: dict[str, dict[str, str]] = {}
    for name, rest in names.items():
        first = re.match(r"([^_.\- ]+)[_.\- ]+(.+)", rest)
        if first and first[1].lower() not in _SIDES and not nobodys(rest):
            groups.setdefault(first[1], {})[name] = first[2]
    named = [n for n, rest in names.items() if not nobodys(rest)]
    large = {p: g for p, g in groups.items() if len(g) >= SUBJECT}
    covered = sum(map(len, large.values()))
    if not large or covered < 0.8 * len(named):
        return {subject: dict(names)}
    some = [set(g.values()) for g in large.values()]
    if any(len(a & b) < ALIKE * min(len(a), len(b)) for i, a in enumerate(some) for b in some[:i]):
        return {subject: dict(names)}  # words of one person's markers, not names of people
    if _most([n for g in large.values() for n in g.values()]) <= _most([names[n] for g in large.values() for n in g]):
        return {subject: dict(names)}  # what is left without them means no more
    inside = {n for g in large.values() for n in g}
    largest = max(large, key=lambda p: len(large[p]))
    large[largest] |= {n: rest for n, rest in names.items() if n not in inside}
    return {f"{subject}:{p}" if subject else p: g for p, g in large.items()}


def _numbered(names: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Bodies whose joints a set numbers: behind a word for them ("landmark_12"), from 0 to the last one of the set; or
    100 times the body's number, and the joint's."""
    if len(names) < SUBJECT:
        return {}
    if points := _behind_a_word(names):
        return {"": points}
    if not all(rest.isdigit() for rest in names.values()):
        return {}
    table = next((s.numbered for s in marker_sets() if s.numbered), ())
    found: dict[str, dict[str, str]] = {}
    for name, rest in names.items():
        body, joint = divmod(int(rest), 100)
        if body < 1 or joint >= len(table):
            return {}
        found.setdefault(f"body {body}", {})[name] = table[joint]
    return found if max(map(len, found.values())) >= SUBJECT else {}


def _behind_a_word(names: Mapping[str, str]) -> dict[str, str]:
    """Meanings of numbers behind one word for key points in the first set with this number of points; empty without
    such a set."""
    count, found = counted(names)
    table = numbered_names(count)
    if table is None or len(set(found.values())) < ALIKE * count:
        return {}
    return {name: table[number] for name, number in found.items()}


def counted(names: Mapping[str, str]) -> tuple[int, dict[str, int]]:
    """The number behind one word for key points that each name is, and how many there are of these; 0 and none if not
    all are such names.

    **Arguments:** `names` full name and the name without the subject's.
    """
    read = {name: _COUNTED.fullmatch(rest) for name, rest in names.items()}
    found = {name: (one[1], int(one[3])) for name, one in read.items() if one}
    if not found or len(found) < len(names) or len({word for word, _ in found.values()}) != 1:
        return 0, {}
    stated = next(one[2] for one in read.values() if one)
    most = max(number for _, number in found.values())
    return max(int(stated or 0), most + 1), {name: number for name, (_, number) in found.items()}


def places_of(names: Mapping[str, str], points: Iterable[str], limbs: Iterable[str]) -> Known:
    """Places of one subject's names by the sets that know most of them.

    **Arguments:** `names` full name and the name without the subject's, see `subjects`; `points`, `limbs` of the body:
    places that it does not have are left out.
    """
    if not names:  # as in most logs: the sets, which take long to read, are not needed
        return Known()
    there = {*points, *limbs}
    named = {full: name for full, name in names.items() if not nobodys(name)}
    found: dict[str, dict[str, str]] = {}
    weights = {}
    for one in marker_sets():
        places = ((full, one.find(_base(name), there)) for full, name in names.items())
        found[one.title], weights[one.title] = {full: place for full, place in places if place}, one.weight
    order = sorted(found, key=lambda title: -len(found[title]))
    best = len(found[order[0]])
    if best < LEAST:
        return Known(unknown=tuple(named))
    # of sets that know about as many, the one that was made for the most exact places
    numbered = [s.title for s in marker_sets() if s.numbered and set(names.values()) <= set(s.numbered)]
    near = numbered or [t for t in order if len(found[t]) >= best - 1]
    order = [max(near, key=lambda t: _exact(found[t]))] + [t for t in order if t not in near] + near
    chosen, used, taken = Known(), [], set()
    for title in dict.fromkeys(order):
        new = {full: place for full, place in found[title].items() if full not in chosen.places}
        if used and (len(found[title]) < SHARE * len(named) or (weights[title] is None) != (weights[used[0]] is None)):
            continue
        exact = {f: split_place(p)[0] for f, p in new.items() if split_place(p)[1] is None and p not in set(limbs)}
        for full, place in new.items():
            if full in exact:
                same = [other for other in exact if exact[other] == exact[full]]
                # two names for one place: the longer says more ("wrist ulna", "ulna"), the other means something else
                if exact[full] in taken or full != max(same, key=lambda n: len(names[n])):
                    continue
                taken.add(exact[full])
            chosen.places[full] = place
            if weights[title] is not None:
                chosen.weights[full] = weights[title]
            used = list(dict.fromkeys([*used, title]))
    unknown = tuple(n for n in named if n not in chosen.places)
    newington = next(one.newington for one in marker_sets() if one.title == used[0])
    return Known(chosen.places, tuple(used), chosen.weights, unknown, newington)


@lru_cache(maxsize=1)
def human_points() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the feature points and joint centres of the default body, and of its limbs; without making the body."""
    file = resources.files("voodoo_jax.model.bodies") / "human.toml"
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    names = lambda kind: tuple(table["name"] for table in content[kind])  # noqa: E731
    return (*names("site"), *names("centre")), names("limb")


def describe_names(names: Iterable[str], settings: FeatureSettings) -> list[str]:
    """Sentences on the meanings of a log's names for the default body, and the setting for the unknown ones."""
    given = check_pairs("features.names", settings.names)
    points, limbs = human_points()
    notes = []
    for subject, group in subjects(names).items():
        own = {f: n for f, n in group.items() if not {f, n} & {*given} and not nobodys(n)}
        known = places_of(own, points, limbs)
        unknown = [name for name in known.unknown if V1_NAMES.get(own[name], own[name]) not in points]
        whose = f" of '{subject}'" if subject else ""
        if known.places:
            notes.append(f"Names{whose}: {len(known.places)} of {len(own)} are known from: {'; '.join(known.titles)}.")
        if unknown:
            line = " ".join(f"'{name}=...'" for name in unknown)
            notes.append(f"Unknown names{whose}; state the point or limb of the body of each: --features.names {line}")
    return notes


def net_key_points(names: Iterable[str]) -> bool:
    """Whether names are those of a pose net or of a depth camera's skeleton, whose sets say what a point weighs."""
    words = [name for group in subjects(names).values() for name in group.values()]
    nets = [one for one in marker_sets() if one.weight is not None]
    most = _most(words, nets)
    return most >= LEAST and most >= _most(words)


def _most(words: Iterable[str], sets: Iterable[MarkerSet] | None = None) -> int:
    """Number of names that the best set knows."""
    words = list(map(_base, words))
    return max(sum(one.find(word) is not None for word in words) for one in sets or marker_sets())


def _base(name: str) -> str:
    """A name without the number that distinguishes objects of one name ("RCOU/12")."""
    before, mark, after = name.rpartition("/")
    return before if mark and after.isdigit() else name


def _exact(places: Mapping[str, str]) -> float:
    """Number of exact places, and a share for the others."""
    return sum(1.0 if split_place(p)[1] is None else 0.6 for p in places.values())
