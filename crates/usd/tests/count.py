"""Counts what OpenUSD finds in the files named on standard input, one a line: an answer that owes nothing to the walker."""

import json
import sys

from pxr import Tf, Usd, UsdGeom

for path in sys.stdin.read().splitlines():
    try:
        stage = Usd.Stage.Open(path)
    except Tf.ErrorException:
        print(json.dumps({"opens": False}))
        continue
    prims = list(stage.Traverse())
    meshes = [UsdGeom.Mesh(prim) for prim in prims if prim.GetTypeName() == "Mesh"]
    points = [mesh.GetPointsAttr().Get() for mesh in meshes]
    shown = 0
    for prim in stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        mesh = UsdGeom.Mesh(prim)
        if mesh and mesh.ComputePurpose() in ("default", "render") and mesh.ComputeVisibility() != "invisible":
            counts = mesh.GetFaceVertexCountsAttr().Get(Usd.TimeCode.EarliestTime())
            shown += any(count > 2 for count in counts or ())
    found = {"opens": True, "prims": len(prims), "meshes": len(meshes), "points": sum(len(array or ()) for array in points)}
    print(json.dumps(dict(found, shown=shown)))
