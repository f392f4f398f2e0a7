# ruff: noqa: E501 (rows of tables)
"""The page docs/papers.md: its text, with places for the tables that __main__ writes."""

import re

TEXT = """# The papers

voodoo_jax began as a new implementation of three papers. This page compares the results of the papers with those of their
methods on our recordings. `python -m experiments.papers RECORDINGS` writes it
([how](../experiments/papers/README.md)). For the present accuracy of voodoo_jax see [Accuracy](accuracy.md).

* **2006**: S. Knoop, S. Vacek, R. Dillmann, *Sensor Fusion for 3D Human Body Tracking with an Articulated 3D Body Model*.
* **2007**: the same, *A Human Body Model for Articulated 3D Pose Tracking*. Both are VooDoo: a person is ten tapering
  elliptic cylinders held together by elastic bands; measured points pull limbs onto themselves by the iterative closest
  point algorithm (ICP).
* **2009**: F. Hecht, P. Azad, R. Dillmann, *Markerless Human Motion Tracking with a Flexible Model and Appearance Learning*:
  masses and springs, followed by particle filters in the images of a stereo camera.

The papers had no ground truth: their results were graded by eye, on real people and sensors of that time. Our recordings are
real human motions on body meshes, seen by simulated sensors with noise, with known joints. So adjacent rows are results on
different data.

All results are from 2026-11-28, with every second of 18 recordings (`--every 2`) on a loaded machine. Compare times only
with each other.

## VooDoo: setup

`--preset knoop2007` and the body `human10` implement the 2007 text as far as it is specified. The start is the only addition
of voodoo_jax on this page: it detects the person in the first frames, and gives pose and size to the papers' loop. From then
on the loop uses the whole cloud of each frame, including floor and walls, and never restarts.

| in the papers | here |
|---|---|
| time-of-flight camera of 160 x 124 pixels | simulated, with the same number or a sixth of the pixels; clouds of more than 2,048 points are subsampled at random |
| skin colour in an image gives lines of sight to face and hands | the recordings contain such lines with a detector's errors, and with known left and right hands |
| enlargements of boxes, longest pair, epsilon, sampling: no values stated | 0.2 m and 0.1 m, 0.25 m, 1e-7 m2; every second point of a limb, from 50 to 200 |
| ratio of artificial to measured pairs from 0.4 to 0.7 | 0.55 |
| joints: ball, hinge, ellipse; the hip is a hinge | the same; axes of 3 % of the stature at hinges, 2 % at the neck |
| exact closest point on the cylinder | four iterations towards it |
| a limb without any measurement: not specified | pairs with a weight of a millionth hold it |
| weights: depth 1, face 30, hands 20; at most 6 steps | the same |
| sizes set by hand | sizes from the start |

## Table I of 2006: lost, acceptable, good

The paper graded 100 sequences by hand as lost, acceptable or good. Here rules grade: a recording is lost if the trunk or two
limbs are more than 20 cm off for more than a second, or at its end. It is good if no joint is 15 cm off for half a second.

{table1}

Compare "fusion" with the paper's row. In "points by our finder", voodoo_jax has removed floor, walls and furniture: then the
papers' method gets grades like the paper's. With whole clouds it loses more than half of the recordings: floor points lie
within the boxes of the shanks and pull the body down, most with depth alone. The papers do not mention the floor; their
camera's range and view may have excluded it.

The [scoreboard](../experiments/scoreboard.md) has the accuracy of voodoo_jax with all its stages.

## Fig. 6 of 2007: depth, lines of sight, and both

The paper shows a person who bows and then waves, tracked by 3D data, by 2D data, and by both. The picture shows the same
motion here, in the paper's frames and in the frame with the fastest wrists. Crosses are the true joints.

![Bodies in seven frames by depth alone, by lines of sight alone, and by both](../experiments/papers/fig6.png)

Dots are the points that voodoo_jax assigns to the person; the loop used all others as well. Mean errors over the recordings
of the table above:

{fig6}

The paper found that 3D data alone follow large movements, but not fast arms; that 2D features alone determine the tracked
parts, but not the body; and that both together are best. The order is the same here. In the picture, depth alone loses the
body to the floor during the bow. Lines of sight alone keep head and hands on their lines, but do not bow the trunk; they
lose people who walk, since a line does not determine the distance along it. Both together follow the bow, head and wrists.

## Fig. 7 of 2007: steps along a sequence

The paper found that one step is enough during slow motion, and that large movements need more. The threshold epsilon ends a
frame; the paper does not state its value.

![ICP steps along the recording, and the person's speed](../experiments/papers/fig7.png)

{fig7}

Here the number of steps depends mostly on epsilon, and hardly on the person's speed: with the floor in the clouds the loop
continues even without motion. The figure shows the first 150 frames of the recording of Fig. 6, with at most 15 steps.

## Fig. 8 of 2007: time by number of steps

The paper reports 20 to 70 ms a frame on a Pentium 4 of 3.2 GHz, increasing with the steps; 6 steps are "a good trade-off" (20
to 25 frames a second; 10 to 14 in 2006). Here a frame is padded to 2,048 points, which each step processes, on one core.

![Processor time and error by number of steps](../experiments/papers/fig8.png)

{fig8}

The relation is linear, as in the paper. Here more steps increase the error, since the floor is among the points: the longer
the loop runs, the more it diverges. So on whole clouds six steps are no good trade-off.

## Fig. 9 of 2007: time by number of measurements

The paper found time to be linear in the number of measurements, and independent of their weights.

![Processor time by number of measurements](../experiments/papers/fig9.png)

{fig9}

This is the same here.

## 2009: the wrist's error by direction

This paper had no ground truth either. Its Fig. 7 compares the wrist with an object in the right hand, measured by stereo. It
finds that the error is largest in depth, and that this component correlates most with the whole error. It gives no numbers.

`--preset hecht2009` has the paper's numbers where it states them (200 particles for each limb and 100 for the head, one
layer, 25 % of them spread in depth by 1.0, 0.5 and 0.15 m, velocity 50 to 80 %, 80 % of the head's motion). It does not
state score weights, thresholds and the scores of hidden samples. "its own start and edges" starts as in section III-C and
requires gradient and motion at each edge. "our start" takes stature, heading and skin from depth; "our edges" gives static
edges half of the weight.

{hecht}

![Error of the right wrist across, up and down, in depth, and in all](../experiments/papers/hecht.png)

The paper's finding holds here: most of the error is in depth, and the whole error correlates with it. But all three variants
lose the hand within one or two seconds. Score weights and thresholds, which the paper does not state, matter much: a search
over them lowers the error, but no set of values tracks both bows and walks
([experiments](../experiments/flexible/README.md)).

Our recordings differ from the paper's in two ways. The paper's background is a first image without a person. Ours show the
person from the first image on, so the background is each pixel's median over the recording, and includes people who stand
still. And by fixed colour limits a third of the image is skin (in the recording drawn above). So the patch detected as a
head is wrong, no pose matches (the best of the first eight images is used), and tracking starts at the wrong place. From the
same start, the paper's edges (gradient and motion) are worse here than ours: a limb at rest has none.

## Ingredients, and the test that fails without each

Each row removes one ingredient of the papers from a copy of the package and runs one test.

{mutations}
"""


NAMES = ("table1", "fig6", "fig7", "fig8", "fig9", "hecht", "mutations")


def filled(kept: dict[str, str]) -> str:
    """The page with its tables; what was not measured is said to be so."""
    text = TEXT
    for name in NAMES:
        if name not in kept:
            text = re.sub(rf"!\[[^\]]*\]\([^)]*/{name}\.png\)\n\n", "", text)
        text = text.replace(f"{{{name}}}", kept.get(name, "*Not measured yet.*"))
    return text
