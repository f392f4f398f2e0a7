"""Body meshes of people: python experiments/people/bodies.py BODIES.npz [SEED [USUAL [KIND]]] (pip install anny).

USUAL people are drawn at random, 26 if nothing is said, and twelve unusual ones are added. KIND "recorded" draws people
as the 18 recordings have them instead (men and women, none between), and adds nobody.
Anny (naver/anny, Apache-2.0, of MakeHuman's CC0 data) needs PyTorch, so this runs in an environment of its own.
"""

import sys

import numpy as np

TUNED = 11  # the seed of those that the built-in human has its shape from
USUAL = 26  # people drawn at random, if no other number is asked for
UNUSUAL = (
    dict(gender=0.9, weight=0.95, muscle=0.4),
    dict(gender=0.1, weight=0.95, muscle=0.6, height=0.4),
    dict(gender=0.2, weight=0.05, muscle=0.3, height=0.6),
    dict(gender=0.8, weight=0.08, muscle=0.2, height=0.45),
    dict(age=0.42, gender=0.3),  # children of 1.55, 1.42 and 1.34 m
    dict(age=0.36, gender=0.8),
    dict(age=0.30, gender=0.5),
    dict(age=0.98, gender=0.7, weight=0.6),
    dict(age=0.98, gender=0.2, weight=0.5, height=0.4),
    dict(muscle=0.95, gender=0.0, weight=0.7),
    dict(gender=1.0, height=0.35, weight=0.75, age=0.8),
    dict(gender=0.0, height=0.42, weight=0.8, muscle=0.5),
)
# from where to where people are drawn; of the recordings' eight, whose lengths tell it
RANGES = {
    "usual": dict(gender=(0, 1), age=(0.6, 0.9), muscle=(0.25, 0.75), weight=(0.25, 0.75), height=(0.25, 0.8),
                  proportions=(0.3, 0.8)),
    "recorded": dict(gender=(0, 1), age=(0.45, 0.85), muscle=(0.35, 0.7), weight=(0.35, 0.7), height=(0.35, 0.7),
                     proportions=(0.33, 0.73)),
}  # fmt: skip
TALLEST, SHORTEST = 2.0, 1.5  # metres, of the usual ones


def main(path: str, seed: str = str(TUNED), usual: str = str(USUAL), kind: str = "usual") -> None:
    """Writes rest meshes, bones and skinning weights of all people; metres, x forward, y left, z up, soles at 0."""
    import anny  # pyright: ignore[reportMissingImports]
    import torch  # pyright: ignore[reportMissingImports]

    model = anny.create_fullbody_model().to(torch.float32)
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # Anny looks along -y
    rng, found = np.random.default_rng(int(seed)), []

    def add(traits: dict[str, float]) -> None:
        with torch.no_grad():
            shape = model(phenotype_kwargs={k: torch.tensor([float(v)]) for k, v in traits.items()})
        vertices, heads = (shape[k][0].numpy() @ turn.T for k in ("rest_vertices", "rest_bone_heads"))
        floor = np.array([0, 0, vertices[:, 2].min()])
        found.append((vertices - floor, heads - floor))

    while len(found) < int(usual):
        traits = {name: float(rng.uniform(*range)) for name, range in RANGES[kind].items()}
        add(traits if kind == "usual" else traits | {"gender": round(traits["gender"])})
        if not SHORTEST < np.ptp(found[-1][0][:, 2]) < TALLEST:
            found.pop()
    for traits in UNUSUAL if kind == "usual" else ():
        add({k: 0.5 for k in ("gender", "muscle", "weight", "height", "proportions")} | {"age": 0.67} | traits)
    np.savez_compressed(
        path,
        vertices=np.stack([v for v, _ in found]).astype(np.float32),
        heads=np.stack([h for _, h in found]).astype(np.float32),
        faces=model.get_triangular_faces().numpy(),
        bones=np.array(model.bone_labels),
        parents=np.array([-1 if p is None else p for p in model.bone_parents]),
        skin=model.vertex_bone_indices.numpy(),
        weights=model.vertex_bone_weights.numpy(),
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
