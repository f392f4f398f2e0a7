"""USD: the limbs as a skinned mesh on a UsdSkel skeleton, animated. Metres, z up; both are stated in the file.

Time codes are frames at the usual rate, at the frames' own times. Frames without pose repeat the last one; the layer's
custom data says which these are. Needs usd-core.
"""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false
# (pxr fills its modules in when they are imported)

import os
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from voodoo_jax.config.output_style import Style
from voodoo_jax.exporters.frames import Z_UP, seconds, usual_rate
from voodoo_jax.exporters.skeleton import SIDE_COLOURS, Skeleton, limb_meshes, skeleton
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing


def write(tracks: Tracks, path: str | os.PathLike[str], style: Style | None = None) -> None:
    """Writes a binary layer (.usd, .usdc), or text if the name ends in .usda. Raises OSError."""
    stage = _stage(tracks, style)
    ending = ".usda" if Path(path).suffix.lower() == ".usda" else ".usdc"
    with replacing(path, ending) as partial:
        if not stage.GetRootLayer().Export(str(partial)):
            raise OSError(f"{path}: USD could not write it")


def _stage(tracks: Tracks, style: Style | None) -> Usd.Stage:
    bones, rate = skeleton(tracks, Z_UP, style), usual_rate(tracks)
    time = seconds(tracks)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(float(time[-1] * rate) if len(time) else 0.0)
    held = Vt.IntArray(np.flatnonzero(bones.held).tolist())
    stage.GetRootLayer().customLayerData = {
        "voodoo_jax": {"source": Path(tracks.source).name, "frames_without_pose": held}
    }
    root = UsdSkel.Root.Define(stage, "/body")
    stage.SetDefaultPrim(root.GetPrim())
    _define_bones(stage, bones, time * rate)
    for mesh in limb_meshes(tracks.body, bones):
        prim = UsdGeom.Mesh.Define(stage, f"/body/{mesh.side}")
        prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(mesh.vertices.astype(np.float32)))
        prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(mesh.normals.astype(np.float32)))
        prim.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        prim.CreateFaceVertexCountsAttr([3] * len(mesh.faces))
        prim.CreateFaceVertexIndicesAttr(mesh.faces.ravel().tolist())
        prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        prim.CreateDisplayColorAttr([Gf.Vec3f(*SIDE_COLOURS[mesh.side])])
        bound = UsdSkel.BindingAPI.Apply(prim.GetPrim())
        bound.CreateSkeletonRel().SetTargets(["/body/skeleton"])
        bound.CreateJointIndicesPrimvar(False, 1).Set(Vt.IntArray(mesh.bones.tolist()))
        bound.CreateJointWeightsPrimvar(False, 1).Set(Vt.FloatArray([1.0] * len(mesh.bones)))
        bound.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    return stage


def _define_bones(stage: Usd.Stage, bones: Skeleton, codes: np.ndarray) -> None:
    paths: list[str] = []
    for name, parent in zip(bones.names, bones.parents):
        paths.append(f"{paths[parent]}/{name}" if parent >= 0 else name)
    prim = UsdSkel.Skeleton.Define(stage, "/body/skeleton")
    at = lambda places: Vt.Matrix4dArray([Gf.Matrix4d().SetTranslate(Gf.Vec3d(*p.tolist())) for p in places])  # noqa: E731
    prim.CreateJointsAttr(paths)
    prim.CreateBindTransformsAttr(at(bones.bind))
    prim.CreateRestTransformsAttr(at(bones.offsets))
    motion = UsdSkel.Animation.Define(stage, "/body/skeleton/tracks")
    motion.CreateJointsAttr(paths)
    motion.CreateScalesAttr([Gf.Vec3h(1)] * len(paths))
    turns, places = motion.CreateRotationsAttr(), motion.CreateTranslationsAttr()
    for i, code in enumerate(codes.tolist()):
        turns.Set([Gf.Quatf(*q) for q in bones.rotation[i].tolist()], code)
        places.Set(Vt.Vec3fArray.FromNumpy(bones.translation[i].astype(np.float32)), code)
    UsdSkel.BindingAPI.Apply(prim.GetPrim()).CreateAnimationSourceRel().SetTargets([motion.GetPath()])
