# ruff: noqa: E501 (rows of tables)
"""The page docs/papers.md: its text, with places for the tables that __main__ writes."""

import re

TEXT = """# The papers

voodoo_jax began as a new implementation of three papers. This page shows what their own systems give on recordings of
ours, next to what the papers say of themselves. It is written by `python -m experiments.papers RECORDINGS`
([how](../experiments/papers/README.md)); what the product does today is on the page [Accuracy](accuracy.md).

* **2006**: S. Knoop, S. Vacek, R. Dillmann, *Sensor Fusion for 3D Human Body Tracking with an Articulated 3D Body Model*.
* **2007**: the same, *A Human Body Model for Articulated 3D Pose Tracking*. Both are VooDoo: a person is ten tapering
  elliptic cylinders held together by elastic bands; measured points pull limbs onto themselves by the iterative closest
  point algorithm (ICP).
* **2009**: F. Hecht, P. Azad, R. Dillmann, *Markerless Human Motion Tracking with a Flexible Model and Appearance Learning*:
  masses and springs, followed by particle filters in the images of a stereo camera.

The papers had no measured truth. Their tables are judged by eye and their figures show real people before real sensors
of that time. Our recordings are real motions on meshes of people, seen by simulated sensors with noise, and the true
joints are known. So rows beside each other say what each reached on its own data, and no more.

What stands here was run on 2026-11-27 with every second of 18 recordings (`--every 2`) on a loaded machine: times are good
for comparing them with each other.

## VooDoo: how it is run here

`--preset knoop2007` and the body `human10` are the 2007 text as far as it goes. For this page nothing of ours comes on
top but the start: the product finds the person in the first frames, and its pose and size begin the papers' loop. From
then on the loop has the whole cloud of each frame, floor and walls among it, and whatever goes wrong stays wrong: there is
no restart.

| in the papers | here |
|---|---|
| time-of-flight camera of 160 x 124 pixels | simulated, as dense or with a sixth of the pixels; clouds of more than 2,048 points are thinned at random |
| skin colour in an image gives lines of sight to face and hands | the recordings hold such lines, as a detector would give them, with errors; which hand is which is known |
| enlargements of boxes, longest pair, epsilon, sampling: named, no values | 0.2 m and 0.1 m, 0.25 m, 1e-7 m2; every second point of a limb, from 50 to 200 |
| ratio of artificial to measured pairs from 0.4 to 0.7 | 0.55 |
| joints: ball, hinge, ellipse; the hip is said to be a hinge | the same; axes of 3 % of the stature at hinges, 2 % at the neck |
| closest point on the cylinder, exactly | four iterations towards it |
| a limb without any measurement: not said | held where it was by pairs that weigh a millionth |
| weights: depth 1, face 30, hands 20; at most 6 steps | the same |
| sizes by hand | by the start |

## Table I of 2006: lost, acceptable, good

The paper graded 100 sequences by hand: lost somewhere, acceptable, good. Here a rule grades: lost is a recording in which
the trunk or two limbs are more than 20 cm off for more than a second, or at its end; good is one in which no joint is 15 cm
off for half a second.

{table1}

"fusion" is the row beside the paper's. Given the person's points alone ("points by our finder": floor, walls and furniture
taken away by the product) the papers' chain grades as the paper does. With whole clouds it loses more than half of the
recordings: floor lies within the boxes of shanks, and pulls the body down into itself, first where depth is all there is.
The papers do not say what becomes of the floor; their camera's range and view may have left it out.

The presets with all that the product adds are measured in the [scoreboard](../experiments/scoreboard.md).

## Fig. 6 of 2007: depth, lines of sight, and both

The paper shows a person who bows and then waves, tracked by 3D data, by 2D data, and by both. The same motion here, the
paper's frames and the frame with the fastest wrists. Crosses are the true joints.

![Bodies in seven frames by depth alone, by lines of sight alone, and by both](../experiments/papers/fig6.png)

Dots are the points that our finder takes for the person's; the loop had all others, too. Over the recordings of the table:

{fig6}

The paper: huge movements are seen by 3D data alone and fast arms are not; 2D features alone determine the tracked parts and
not the body; both together are best. The order is the same here. In the picture depth alone loses the body to the floor
during the bow; lines of sight alone keep head and hands on their lines, but do not bow the trunk, and lose who walks
altogether, for a line does not say how far along it somebody is; both together bow, and keep head and wrists.

## Fig. 7 of 2007: steps along a sequence

The paper: one step is enough while nothing moves much, extensive movements take more. Where a frame stops is decided by
epsilon, of which the paper gives no value.

![ICP steps along the recording, and the person's speed](../experiments/papers/fig7.png)

{fig7}

How many steps are taken follows from epsilon first of all, and hardly from the person's speed: the floor in the clouds keeps
the loop busy while nothing moves. The first 150 frames of the recording of Fig. 6 are shown, with at most 15 steps.

## Fig. 8 of 2007: time by number of steps

The paper: 20 to 70 ms a frame on a Pentium 4 of 3.2 GHz, rising with the steps; 6 steps are "a good trade-off" (20 to 25
frames a second; 10 to 14 in 2006). Here a frame is padded to 2,048 points, all of which are looked at in each step, on one
core.

![Processor time and error by number of steps](../experiments/papers/fig8.png)

{fig8}

The line is straight, as in the paper. More steps do not help here, they harm: limb by limb, and with the floor among the
points, a loop that runs longer goes farther astray. That six are a good trade-off is not seen on whole clouds.

## Fig. 9 of 2007: time by number of measurements

The paper: linear in the number of measurements, and independent of their weights.

![Processor time by number of measurements](../experiments/papers/fig9.png)

{fig9}

As in the paper the time is linear in the number of measurements, and what they weigh does not matter.

## 2009: the wrist's error by direction

The paper had no truth either: its Fig. 7 compares an object in the right hand, found by stereo, with the wrist, and says
that the error is largest in depth, which also goes most with the whole error. Its text gives no numbers.

`--preset hecht2009` has the paper's numbers where there are any (200 particles for each limb and 100 for the head, one
layer, 25 % of them spread in depth by 1.0, 0.5 and 0.15 m, velocity 50 to 80 %, 80 % of the head's motion). Score weights,
thresholds and what hidden samples score are not in the text. "its own start and edges" starts as section III-C has it and
asks for gradient and motion at each edge; "our start" takes stature, heading and skin from depth, "our edges" counts still
edges half.

{hecht}

![Error of the right wrist across, up and down, in depth, and in all](../experiments/papers/hecht.png)

The paper's finding holds here: most of the error is in depth, and the whole error goes with it. What does not hold is that
arms are followed: all three ways lose the hand within a second or two. Score weights and thresholds, which the paper leaves
open, decide much ([experiments](../experiments/flexible/README.md): a search over them gains, and no set of numbers holds
bows as well as walks).

What does not fit: the paper's background is the first image, in which nobody stands; in our recordings the person is there
from the first image on, so each pixel's median over the recording stands for it, and whoever stands still is background. By
fixed limits of colour a third of the image is skin, too (in the recording drawn above). So the patch that is taken for a
head is none, no pose matches (the best of the first eight images is taken), and the tracking begins in the wrong place.
The paper's edges, gradient and motion at once, are worse here than ours from the same start: a limb that rests has none.

## Ingredients, and the test that fails without each

Each line takes one ingredient of the papers away, by a change of one text in a copy of the package, and runs one test.

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
