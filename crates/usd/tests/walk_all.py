"""Runs the walker (`python/walk.py`) on USD files, in one process. Standard input lists the files,
one per line. The only argument is a folder for the scene packages 0, 1, 2, ...

Prints a line of JSON for each file: counts by OpenUSD itself, without the walker; and the reason if
there is no scene package.
"""

import json
import os
import sys
import types

from pxr import Tf, Usd, UsdGeom

package = types.ModuleType("lumistack_usd")
package.__path__ = [os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "python")]
sys.modules["lumistack_usd"] = package
sys.dont_write_bytecode = True

from lumistack_usd import walk, writer


def count(path):
    try:
        stage = Usd.Stage.Open(path)
    except Tf.ErrorException:
        return {"opens": False}
    prims = list(stage.Traverse())
    meshes = [UsdGeom.Mesh(prim) for prim in prims if prim.GetTypeName() == "Mesh"]
    points = [mesh.GetPointsAttr().Get() for mesh in meshes]
    points = sum(len(array) for array in points if hasattr(array, "__len__"))
    return {"opens": True, "prims": len(prims), "meshes": len(meshes), "points": points, "shown": shown(stage)}


def shown(stage):
    """Counts visible meshes of render geometry with faces, including instances."""
    found = 0
    time = Usd.TimeCode.EarliestTime()
    for prim in stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        mesh = UsdGeom.Mesh(prim)
        if mesh and mesh.ComputePurpose() in ("default", "render") and mesh.ComputeVisibility(time) != "invisible":
            counts = mesh.GetFaceVertexCountsAttr().Get(time)
            # a transform that flattens a mesh leaves no visible surface
            is_flat = abs(mesh.ComputeLocalToWorldTransform(time).GetDeterminant3()) < 1e-9
            found += not is_flat and hasattr(counts, "__len__") and any(count > 2 for count in counts)
    return found


for number, path in enumerate(sys.stdin.read().splitlines()):
    found = count(path)
    try:
        package = walk.walk({"path": path})
        with open(os.path.join(sys.argv[1], str(number)), "wb") as file:
            package.write(file)
    except writer.Refused as refused:
        found["refused"] = str(refused)
    print(json.dumps(found))
