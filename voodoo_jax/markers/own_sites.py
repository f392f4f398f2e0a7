"""Points of the body for the markers of a recording: one for each marker, for any number of markers on a limb. Host
side.

A marker's name gives its place on the body to some centimetres; a fit gives its place on this person. So every marker
has a feature point of its own. Their number on each limb is rounded up, so that recordings of other sets need no new
program.
"""

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from voodoo_jax.config.options import FeatureSettings, Settings
from voodoo_jax.config.toml import check_pairs
from voodoo_jax.geometry.rigid import on_device, on_host
from voodoo_jax.model.body import Body, Topology
from voodoo_jax.model.marker_names import LEAST, Known, places_of, split_place, subjects
from voodoo_jax.model.marker_sets import V1_NAMES
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Subject

OWN = " marker "  # in the names of such points: no body file has it
ROOM = 16  # set by hand: markers on one limb that there is room for; more come in steps of so many


class Named(NamedTuple):
    """The named points of one person in a recording, and the meanings of their names."""

    known: Known
    subject: str  # whose markers they are; "": the log says nobody
    others: dict[str, tuple[str, ...]]  # names by other subjects in the log, which are left out


def named_subject(people: list[BodyObservation], topology: Topology, settings: FeatureSettings) -> Named:
    """The first of `named_subjects`; an empty one without named points."""
    return next(iter(named_subjects(people, topology, settings)), Named(Known(), "", {}))


def named_subjects(people: list[BodyObservation], topology: Topology, settings: FeatureSettings) -> list[Named]:
    """The subjects of a recording's named points, and the places of their names by the settings, marker sets or the
    body: subjects with a body's points before wands and boxes, then by the number of measurements."""
    seen = Counter(n for f in people for n in (*f.pairs.names, *f.rays.names))
    groups = subjects(seen)
    known = {s: _known(names, topology, settings) for s, names in groups.items()}
    count = {s: sum(seen[n] for n in names) for s, names in groups.items()}
    order = sorted(groups, key=lambda s: (len(known[s].places) < LEAST, -count[s]))
    return [Named(known[s], s, {other: tuple(groups[other]) for other in order if other != s}) for s in order]


def _known(names: Mapping[str, str], topology: Topology, settings: FeatureSettings) -> Known:
    """Meanings of one subject's names; full name, and the name without the subject's."""
    points = (*topology.sites, *topology.centres)
    given = check_pairs("features.names", settings.names)
    said, joints = {}, {}
    for full, name in names.items():
        word = full if full in given else name
        if word in given:
            said[full] = given[word]
        elif (place := V1_NAMES.get(name, name)) in points:
            joints[full] = place
    known = places_of(names, points, topology.limbs)
    # a name such as r_knee is the joint's, unless the log speaks of markers: then it is one on the knee
    stated = {*said, *joints} if len(known.places) <= len(joints) + len(said) else {*said}
    by_set = {n: p for n, p in known.places.items() if n not in stated}
    places = {n: p for n, p in {**joints, **by_set, **said}.items() if "|" not in p}
    return Known(
        places,
        known.titles if by_set else (),
        {n: w for n, w in known.weights.items() if n in by_set},
        tuple(n for n in known.unknown if n not in places and n not in said),
        known.newington,
    )


def apart_by_names(subject: Subject, topology: Topology, settings: FeatureSettings) -> list[Subject]:
    """The people whose markers a recording of markers alone names, the one with the most markers first; the subject
    itself if there is only one."""
    named = [n for n in named_subjects(subject.frames, topology, settings) if len(n.known.places) >= LEAST]
    if len(named) < 2:
        return [subject]
    return [Subject(k, subject.scene, of_subject(subject.frames, n), n.subject) for k, n in enumerate(named, 1)]


def of_subject(people: list[BodyObservation], named: Named) -> list[BodyObservation]:
    """The frames without the named points of other subjects."""
    others = {n for names in named.others.values() for n in names}
    if not others:
        return people
    own = lambda some: some.only(np.array([n not in others for n in some.names], bool))  # noqa: E731
    return [replace(f, pairs=own(f.pairs), rays=own(f.rays)) for f in people]


def with_names(
    body: Body, people: list[BodyObservation], settings: Settings
) -> tuple[list[BodyObservation], Settings, Named]:
    """The frames with the named points of one subject, the settings with the meanings of their names, and the
    subject."""
    t = body.topology
    named = named_subject(people, t, settings.features)
    features = with_meanings(settings.features, named.known, (*t.sites, *t.centres))
    return of_subject(people, named), replace(settings, features=features), named


def with_meanings(settings: FeatureSettings, known: Known, points: Collection[str]) -> FeatureSettings:
    """The settings with the meanings of names that are among the body's `points`; existing entries stay."""
    given = check_pairs("features.names", settings.names)
    weighed = check_pairs("features.weights", settings.weights)
    places = {n: split_place(p)[0] for n, p in known.places.items()}
    names = tuple(f"{n}={p}" for n, p in places.items() if n not in given and p in points)
    weights = tuple(f"{n}={w:g}" for n, w in known.weights.items() if n not in weighed)
    return replace(settings, names=(*settings.names, *names), weights=(*settings.weights, *weights))


def with_own_names(settings: FeatureSettings, own: Mapping[str, str]) -> FeatureSettings:
    """The settings with the points that `with_own_sites` gave the markers, in place of their former entries for
    these."""
    given = check_pairs("features.names", settings.names)
    names = {**{n: p for n, p in given.items() if n not in own}, **own}
    return replace(settings, names=tuple(f"{n}={p}" for n, p in names.items()))


def with_own_sites(body: Body, places: Mapping[str, str]) -> tuple[Body, dict[str, str]]:
    """The body with points for all markers, and the name of each marker's point.

    **Arguments:** `places` of the markers by name: a point or a limb of the body, perhaps with "~" and metres behind.
    Places that the body does not have are left out.
    """
    host, t = on_host(body), body.topology
    points = {n: (limb, at) for n, limb, at in zip(t.centres, t.centre_limbs, np.asarray(host.centres))}
    points |= {n: (limb, at) for n, limb, at in zip(t.sites, t.site_limbs, np.asarray(host.sites)) if n not in points}
    for i, limb in enumerate(t.limbs):
        points.setdefault(limb, (i, np.array([0, 0, host.sizes[i, 4] / 2])))
    there = {name: points[point] for name, place in places.items() if (point := split_place(place)[0]) in points}
    most = max(Counter(limb for limb, _ in there.values()).values(), default=0)
    room = ROOM * max(1, -(-most // ROOM))
    at = np.zeros((len(t.limbs), room, 3), np.asarray(host.sites).dtype)
    used, own = [0] * len(t.limbs), {}
    for name, (limb, place) in there.items():
        at[limb, used[limb]] = place
        own[name] = f"{t.limbs[limb]}{OWN}{used[limb]}"
        used[limb] += 1
    names = tuple(f"{limb}{OWN}{k}" for limb in t.limbs for k in range(room))
    owners = tuple(i for i in range(len(t.limbs)) for _ in range(room))
    topology = t._replace(sites=t.sites + names, site_limbs=t.site_limbs + owners)
    sites = np.concatenate([np.asarray(host.sites), at.reshape(-1, 3)])
    return on_device(replace(host, sites=sites, topology=topology)), own


def without_own_sites(body: Body) -> Body:
    """The body without the points that `with_own_sites` gave it."""
    t = body.topology
    kept = [k for k, name in enumerate(t.sites) if OWN not in name]
    names, owners = (tuple(some[k] for k in kept) for some in (t.sites, t.site_limbs))
    topology = t._replace(sites=names, site_limbs=owners)
    return on_device(replace(on_host(body), sites=np.asarray(body.sites)[kept], topology=topology))
