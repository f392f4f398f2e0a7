# ruff: noqa: E501 (a change a line, as the code has it)
"""Which test fails when an ingredient of the papers is taken away: each change is made in a copy of the package, and the
test that is named is run there. A change that no test notices has survived.
"""

import contextlib
import importlib.util
import io
import multiprocessing
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from tqdm import tqdm

from experiments.common import table

ROOT = Path(__file__).parents[2]
KNOOP, HECHT = "tests/solve/test_papers_ingredients.py", "tests/trackers/flexible/test_papers_ingredients.py"
GATE = "tests/kernels/test_gate.py::test_rules_by_hand"
BANDS = "tests/kernels/test_bands.py::test_moments_are_explicit_pairs_on_both_limbs"
KINDS = "tests/kernels/test_bands.py::test_special_cases"


@dataclass(frozen=True)
class Ingredient:
    """What a paper says, where, and how it is taken away."""

    what: str
    said: str
    file: str  # of voodoo_jax
    old: str
    new: str
    test: str  # that fails then


def _knoop(what: str, said: str, file: str, old: str, new: str, test: str) -> Ingredient:
    return Ingredient(what, f"2007, {said}", file, old, new, test if "::" in test else f"{KNOOP}::{test}")


def _hecht(what: str, said: str, file: str, old: str, new: str, test: str) -> Ingredient:
    return Ingredient(what, f"2009, {said}", f"trackers/flexible/{file}", old, new, f"{HECHT}::{test}")


LIMB = "test_a_limb_is_a_tapering_elliptic_cylinder_with_ends"
FAR = "test_points_far_from_the_body_from_limbs_or_from_their_pair_are_discarded"
FEW = "test_point_number_reduction_keeps_few_points_and_thins_many"
KNOWN = "test_points_known_to_be_on_the_body_and_on_a_limb"
NAMED = "test_a_named_point_pulls_to_its_place_and_a_line_of_sight_to_its_closest_point"
BEST = "test_the_best_rotation_and_translation"
UNTIL = "test_it_repeats_until_the_measure_rests_or_so_many_steps_are_done"
TREE = "test_the_papers_body_is_a_tree_of_ten_limbs_with_three_kinds_of_joints"
SPRINGS = "test_springs_limits_and_collisions_each_hold"
MOVED = "test_the_head_is_put_where_it_was_measured_and_the_body_follows_most_of_its_way_and_dangles"
NOISE = "test_noise_has_a_base_and_more_where_particles_are_apart_and_where_the_image_moves"
DEPTH = "test_a_quarter_of_the_particles_is_spread_in_depth_most_at_the_end"
SCORES = "test_borders_on_edges_and_surfaces_of_the_known_colour_score"
HIDDEN = "test_what_is_hidden_or_outside_of_the_image_scores_a_default"
RINGS = "test_ten_rings_of_colour_are_read_linearly_and_learnt_as_a_mean"
EDGES = "test_the_edge_image_has_gradients_and_twice_as_much_where_they_move"
FRAME = "test_a_frame_puts_the_filters_means_into_the_body_with_masses_by_how_sure_they_are"

INGREDIENTS = (
    _knoop("limbs taper", "4", "kernels/frustum.py", "a0, b0, a1, b1, length = (jnp.maximum(size[i], TINY) for i in range(5))\n    centre", "a0, b0, a1, b1, length = (jnp.maximum(size[i], TINY) for i in (0, 1, 0, 1, 4))\n    centre", LIMB),
    _knoop("limbs are elliptic", "4", "kernels/frustum.py", "a0, b0, a1, b1, length = (jnp.maximum(size[i], TINY) for i in range(5))\n    centre", "a0, b0, a1, b1, length = (jnp.maximum(size[i], TINY) for i in (0, 0, 2, 2, 4))\n    centre", LIMB),
    _knoop("limbs have ends", "4", "kernels/frustum.py", "flat = bottom | top", "flat = jnp.zeros_like(bottom)", LIMB),
    _knoop("a tree of ten limbs", "4", "model/bodies/human10.toml", 'parent = "l_upper_arm"\nchild = "l_forearm"', 'parent = "torso"\nchild = "l_forearm"', TREE),
    _knoop("hinges at elbows and knees", "4.2", "model/bodies/human10.toml", 'child = "r_shank"\nat = [0, -0.0629, 0.289]\naxes = [0, 0.03]', 'child = "r_shank"\nat = [0, -0.0629, 0.289]\naxes = [0, 0]', TREE),
    _knoop("an elliptic joint at the neck", "4.2", "model/bodies/human10.toml", "axes = [0.02, 0.02]", "axes = [0.02, 0]", TREE),
    _knoop("bands at both ends of an axis", "4.2", "model/body.py", "[-a, zero, zero]", "[a, zero, zero]", KINDS),
    _knoop("a band of a joint without axes is one", "4.2", "model/body.py", "mask / mask.sum(-1, keepdims=True)", "mask", KINDS),
    _knoop("each band pulls both limbs", "4.3", "kernels/bands.py", ".at[links.first].add(there).at[links.second].add(back)", ".at[links.first].add(there)", BANDS),
    _knoop("bands are artificial pairs in the solve", "4.3", "solve/frame.py", "held = sum(link_moments(some, poses, pulls.strength) for some in pulls.links)", "held = 0.0 * sum(link_moments(some, poses, pulls.strength) for some in pulls.links)", "test_limbs_are_solved_each_by_itself_and_bands_pass_the_motion_on"),
    _knoop("bands weigh by the limb's measurements", "4.3", "solve/pulls.py", "strength = options.ratio * jnp.maximum(limb_weight, options.floor * total_weight(problem))", "strength = options.ratio * jnp.ones_like(limb_weight)", "test_bands_weigh_as_a_limbs_own_measurements_do"),
    _knoop("a point belongs to the closest limb", "3.2", "kernels/assignment.py", "closer = signed < nearest", "closer = (signed < jnp.inf) & (winner == limbs)", "test_a_point_is_a_measurement_of_the_closest_limb"),
    _knoop("pairs that are too long are discarded", "3.2", "kernels/correspondences.py", "keep = chosen & (d2 <= options.max_distance**2) if", "keep = chosen if", FAR),
    _knoop("box of the whole body", "5.2", "kernels/assignment.py", "near_body = in_box(low, high, points.xyz)", "near_body = in_box(low - 9.0, high + 9.0, points.xyz)", FAR),
    _knoop("boxes of limbs", "5.2", "kernels/assignment.py", "inside = in_limb_box(size, px, py, pz, options.limb_enlarge)", "inside = in_limb_box(size, px, py, pz, options.limb_enlarge + 9.0)", FAR),
    _knoop("overlap: exclusive", "5.2", "kernels/bounding_boxes.py", "return candidate & (limb[:, None] == winner[None, :])", "return candidate", GATE),
    _knoop("overlap: shared", "5.2", "kernels/bounding_boxes.py", 'if rule in ("shared", "soft"):\n        return candidate\n', 'if rule == "soft":\n        return candidate\n', GATE),
    _knoop("overlap: adjacent", "5.2", "kernels/bounding_boxes.py", "return candidate & adjacent[winner].T", "return candidate", GATE),
    _knoop("point reduction: factor", "5.2", "kernels/assignment.py", "share = jnp.round(sampling.factor * count)", "share = jnp.round(1.0 * count)", FEW),
    _knoop("point reduction: least", "5.2", "kernels/assignment.py", "jnp.clip(share, sampling.least, sampling.most)", "jnp.minimum(share, sampling.most)", FEW),
    _knoop("point reduction: most", "5.2", "kernels/assignment.py", "jnp.clip(share, sampling.least, sampling.most)", "jnp.maximum(share, sampling.least)", FEW),
    _knoop("points known to be on the body", "5.1", "kernels/assignment.py", "near_body |= points.limb != FREE", "near_body |= points.limb >= 0", KNOWN),
    _knoop("points known to be on a limb", "5.1", "kernels/assignment.py", "return jnp.where(points.limb >= 0, points.limb == limb, inside)", "return inside", KNOWN),
    _knoop("pairs of points", "5.1", "kernels/landmarks.py", "jnp.concatenate([ones, c + gap])", "jnp.concatenate([ones, c])", NAMED),
    _knoop("rays: the closest point on the line", "5.2", "kernels/landmarks.py", "along = jnp.sum(d * (world - features.origin), -1, keepdims=True)", "along = 0.0 * jnp.sum(d * (world - features.origin), -1, keepdims=True)", NAMED),
    _knoop("features are named points of the body", "4", "config/options.py", '"face=sellion",', '"face=skull_vertex",', "test_features_are_named_points_of_the_body"),
    _knoop("measurements weigh by their sensor", "6", "kernels/correspondences.py", "jnp.where(keep, robust * weight, 0.0)", "jnp.where(keep, robust, 0.0)", "test_a_measurement_that_weighs_three_counts_as_three"),
    _knoop("depth 1, face 30, hands 20", "7", "config/preset_files/knoop2007.toml", '"face=30"', '"face=3"', "test_the_papers_numbers"),
    _knoop("best translation", "3.2", "kernels/eigen.py", "data - rotate(q, model))", "data - model)", BEST),
    _knoop("best rotation by quaternions", "3.2", "kernels/eigen.py", "q = quat_normalize(q * jnp.where(q[0] >= 0, 1.0, -1.0))", "q = jnp.array([1.0, 0, 0, 0], k.dtype) + 0.0 * q", BEST),
    _knoop("limbs are solved each by itself", "5.2", "config/preset_files/knoop2007.toml", 'solver = "per_limb"', 'solver = "coupled"', "test_the_papers_numbers"),
    _knoop("it stops where the measure rests", "3.2", "solve/frame.py", "            return jnp.abs(fallen) < options.epsilon\n", "            return jnp.abs(fallen) < 0.0\n", UNTIL),
    _knoop("at most so many steps", "5.2", "solve/frame.py", "return ~state.rest & (state.steps < options.max_steps)", "return ~state.rest & (state.steps < 50)", UNTIL),
    _knoop("a frame begins where the last one ended", "5.2", "solve/scan.py", "translation = state.poses.translation + gone", "translation = body.rest.translation + gone", "test_a_frame_begins_where_the_last_one_ended"),
    _knoop("limbs may be taken away", "5.2", "kernels/assignment.py", "_signed_if_near(limb, present[limb],", "_signed_if_near(limb, near_body,", "test_a_limb_that_is_taken_away_has_no_points"),
    _hecht("Verlet steps", "II", "physics.py", "return x + (1 - damping) * (x - before) + acceleration * dt**2", "return x + acceleration * dt**2", "test_a_verlet_step_goes_on_as_before_and_falls"),
    _hecht("springs", "II", "physics.py", "x = x + d * (pulls.share[group] * (now - pulls.rest[group]) / now)", "x = x + d * (0.0 * pulls.share[group] * now)", SPRINGS),
    _hecht("the head has an infinite mass", "II", "physics.py", "return jnp.where(jnp.isinf(masses), 0.0, 1 / jnp.where(jnp.isinf(masses), 1.0, masses))", "return 1 / jnp.where(jnp.isinf(masses), 1.0, masses)", SPRINGS),
    _hecht("limits of angles", "II", "physics.py", "over = [jnp.maximum(least * now - n.dot(d), 0.0)", "over = [0.0 * jnp.maximum(least * now - n.dot(d), 0.0)", SPRINGS),
    _hecht("arms stay out of the torso", "II", "physics.py", "space.is_arm * (1 / jnp.maximum(r, 0.05) - 1), 0.0)", "0.0, 0.0)", SPRINGS),
    _hecht("a plane between the legs", "II, IV-B", "physics.py", "across = (1 - space.is_arm) * jnp.maximum(space.apart - local.dot(space.outward), 0.0)", "across = 0.0 * local.dot(space.outward)", SPRINGS),
    _hecht("gravity", "II", "filters.py", "pull = jnp.broadcast_to(-n.gravity * given.up, x.shape)", "pull = jnp.zeros_like(x)", MOVED),
    _hecht("the head is put where it was measured", "III", "filters.py", ".at[HEAD].add(move - follow)", "", MOVED),
    _hecht("the body follows 80 % of the head's way", "III", "filters.py", "follow = n.follow[0] * (move - high) + n.follow[1] * high", "follow = move", MOVED),
    _hecht("filters' means overwrite the body's points", "III", "filters.py", "x = x.at[LIMBS.ravel()].set(mean.reshape(12, 3))", "x = x.at[LIMBS.ravel()].set(mean.reshape(12, 3) + 1.0)", FRAME),
    _hecht("masses by confidence", "III", "filters.py", "(n.masses[0] + n.masses[1] * jnp.exp(-n.masses[2] * spread)).ravel()", "(n.masses[0] + n.masses[1] + 0.0 * spread).ravel()", FRAME),
    _hecht("damped constant velocity", "III-A", "filters.py", "return state.particles + n.velocity * (state.particles - state.previous)", "return state.particles", "test_particles_go_on_with_a_share_of_their_velocity"),
    _hecht("base noise", "III-A", "filters.py", "sigma = n.base_noise + n.spread_noise", "sigma = 0.0 * n.base_noise + n.spread_noise", NOISE),
    _hecht("noise by the particles' spread", "III-A", "filters.py", "+ n.spread_noise * jnp.minimum(spread[i], 0.2)", "+ 0.0 * spread[i]", NOISE),
    _hecht("noise by the image's motion", "III-A", "filters.py", "+ n.motion_noise * motion", "+ 0.0 * motion", NOISE),
    _hecht("noise in depth", "III-A", "filters.py", "deep.where(pick < n.depth_share, plain)", "plain", DEPTH),
    _hecht("most noise in depth at the ends", "III-A", "filters.py", "n.depth_noise[i] * normal[3, i]", "n.depth_noise[0] * normal[3, i]", DEPTH),
    _hecht("particles keep the constraints", "III-A", "filters.py", "moved = project_limb((points[0], points[1], points[2]), jnp.ones((3, 1)), space, _SWEEPS)", "moved = points[0], points[1], points[2]", "test_particles_are_brought_back_to_what_a_limb_can_be"),
    _hecht("edge score", "III-B", "scores.py", "edge = jnp.where(shown, channels(pixels)[3], w.hidden_edge)", "edge = jnp.where(shown, 0.5, w.hidden_edge)", SCORES),
    _hecht("surface score", "III-B", "scores.py", "alike = known * jnp.exp(-off / w.colour_scale)", "alike = known * jnp.exp(-0.0 * off)", SCORES),
    _hecht("occlusion model", "III-B", "scores.py", "own = np.arange(4)[:, None] == np.arange(len(near)) // 2", "own = np.arange(4)[:, None] <= np.arange(len(near))", "test_an_arm_before_the_trunk_hides_it_from_the_other_limbs"),
    _hecht("hidden samples score a default", "III-B", "scores.py", "visible = inside & ~behind & ~covered", "visible = inside & ~covered", HIDDEN),
    _hecht("samples outside of the view, too", "III-B", "scores.py", "shown = inside & (nearest >= at.border.z - 0.02)", "shown = nearest >= at.border.z - 0.02", HIDDEN),
    _hecht("colours between rings are interpolated", "III-B", "scores.py", "share = jnp.clip(t - low, 0, 1)[:, None]", "share = 0.0 * (t - low)[:, None]", RINGS),
    _hecht("colours are learnt as a running mean", "III-B", "scores.py", "return colours + share * (mean - colours), now", "return jnp.where(count[..., None] > 0, mean, colours), now", RINGS),
    _hecht("once learnt, colours are frozen", "III-B", "filters.py", "colours, learnt = lax.cond(given.learn > 0, more, lambda: (state.colours, state.learnt))\n", "colours, learnt = state.colours + 0.1, state.learnt\n", FRAME),
    _hecht("edges of gradients", "III-B", "image_features.py", "gradient * (0.5 + 0.5 * near)", "1.0 * near", EDGES),
    _hecht("moving edges score more", "III-B", "image_features.py", "gradient * (0.5 + 0.5 * near)", "gradient", EDGES),
    _hecht("a blurred image of motion", "III-A", "image_features.py", "return edge, np.clip(motion * 255, 0, 255).astype(np.uint8)", "return edge, np.zeros_like(motion).astype(np.uint8)", EDGES),
    _hecht("particles are drawn by their weights", "III", "scores.py", "total = jnp.cumsum(weights)\n    places", "total = jnp.cumsum(jnp.ones_like(weights))\n    places", "test_particles_are_drawn_by_their_weights"),
    Ingredient("200 particles of a limb, 100 of the head", "2009, IV-A", "config/preset_files/hecht2009.toml", "\nparticles = 200", "\nparticles = 50", f"{HECHT}::test_the_papers_numbers"),
)  # fmt: skip


def survivors(ingredients: tuple[Ingredient, ...], checked: bool = False) -> list[tuple[Ingredient, bool]]:
    """Each ingredient, and whether its test passes without it; `checked`: all tests are known to pass with it. Raises
    ValueError for a text that is not in its file, and for a test that fails as it is."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("voodoo_jax", "tests"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / name, copy / name)
        if not checked and not _passes(copy, *sorted({one.test for one in ingredients})):
            raise ValueError("a test fails before anything is taken away")
        for one in tqdm(ingredients, "mutations", leave=False, disable=None):
            file = copy / "voodoo_jax" / one.file
            text = file.read_text()
            if text.count(one.old) != 1:
                raise ValueError(f"{one.what}: {one.file} has the text {text.count(one.old)} times: {one.old}")
            _write(file, text.replace(one.old, one.new))
            found.append((one, _passes(copy, one.test)))
            _write(file, text)
            print(f"{'SURVIVES' if found[-1][1] else 'fails'}: {one.what}", flush=True)
    return found


def _write(file: Path, text: str) -> None:
    """Writes a module, and forgets what was compiled of it: both texts may be of one second and one size."""
    file.write_text(text)
    Path(importlib.util.cache_from_source(str(file))).unlink(missing_ok=True)


def _passes(copy: Path, *tests: str) -> bool:
    """Whether tests pass in a copy of the package. By a fork of a process that has imported all that the package is
    built on, which takes longer than a test, and that has no threads: a fork of this one hangs once JAX has computed."""
    child = multiprocessing.get_context("forkserver").Process(target=_run, args=(copy, tests))
    child.start()
    child.join()
    if child.exitcode not in (0, 1):
        raise RuntimeError(f"{tests}: pytest ended with {child.exitcode}")
    return child.exitcode == 0


def _run(copy: Path, tests: tuple[str, ...]) -> None:
    """Runs tests with the package and the tests of the copy alone."""
    for name in [name for name in sys.modules if name.split(".")[0] in ("voodoo_jax", "tests")]:
        del sys.modules[name]
    sys.path.insert(0, str(copy))
    os.chdir(copy)
    importlib.invalidate_caches()
    with contextlib.redirect_stdout(io.StringIO()):
        code = pytest.main(["-q", "-x", "-W", "ignore", "-p", "no:cacheprovider", "--rootdir", str(copy), *tests])
    where = sys.modules["voodoo_jax"].__file__ or ""
    os._exit(int(code) if where.startswith(str(copy)) else 9)


def report(found: list[tuple[Ingredient, bool]]) -> str:
    """Table of ingredients and their tests."""
    rows = [
        [
            one.what,
            one.said,
            f"`{one.test.removeprefix('tests/').replace('::', '` `')}`",
            "**passes**" if alive else "fails",
        ]
        for one, alive in found
    ]
    count = sum(alive for _, alive in found)
    said = f"\n{len(found)} ingredients are taken away, one at a time; {count} of these changes survive.\n"
    return table(["ingredient", "where it is said", "test", "without it"], rows, 4) + said
