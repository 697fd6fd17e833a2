"""Skinned and blended shapes, posed by UsdSkel's own queries."""

from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

EVERYWHERE = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)


def source(prim):
    """The prim in its prototype, if it is in one."""
    return prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim


class Skeletons:
    """All skeletons of the roots seen so far."""

    def __init__(self, time):
        self.time = time
        self.cache = UsdSkel.Cache()
        self.skinned = {}

    def add(self, root):
        """Finds what a `UsdSkelRoot` poses."""
        root = UsdSkel.Root(root)
        if not self.cache.Populate(root, EVERYWHERE):
            return
        for binding in self.cache.ComputeSkelBindings(root, EVERYWHERE):
            query = self.cache.GetSkelQuery(binding.GetSkeleton())
            for target in binding.GetSkinningTargets():
                self.skinned[target.GetPrim().GetPath()] = (query, target)

    def key(self, prim):
        """What tells the poses of one shape apart."""
        found = self.skinned.get(prim.GetPath())
        if found is None:
            return None
        animation = found[0].GetAnimQuery()
        return (
            source(found[0].GetPrim()).GetPath(),
            source(animation.GetPrim()).GetPath() if animation else None,
        )

    def pose(self, prim):
        """(points, normals primvar as (interpolation, values) or None) of a posed mesh in its own space, or None."""
        found = self.skinned.get(prim.GetPath())
        if found is None:
            return None
        query, target = found
        mesh = UsdGeom.Mesh(prim)
        points = mesh.GetPointsAttr().Get(self.time)
        if points is None:
            return None
        points = Vt.Vec3fArray(points)
        if target.HasBlendShapes():
            self.blend(query, target, points)
        if not (target.HasJointInfluences() and query):
            return points, None
        to_world = UsdGeom.XformCache(self.time)
        # the skeleton poses in its own space
        back = to_world.GetLocalToWorldTransform(query.GetPrim()) * to_world.GetLocalToWorldTransform(prim).GetInverse()
        joints = query.ComputeSkinningTransforms(self.time)
        if not joints:
            return points, None
        joints = Vt.Matrix4dArray([joint * back for joint in joints])
        if target.IsRigidlyDeformed():
            matrix = target.ComputeSkinnedTransform(joints, self.time)
            points = Vt.Vec3fArray([matrix.Transform(point) for point in points])
        elif not target.ComputeSkinnedPoints(joints, points, self.time):
            return None
        return points, self.normals(mesh, target, joints, len(points))

    def blend(self, query, target, points):
        animation = query.GetAnimQuery() if query else None
        weights = animation.ComputeBlendShapeWeights(self.time) if animation else None
        if weights is None:
            return
        mapper = target.GetBlendShapeMapper()
        if mapper:
            weights = mapper.Remap(weights)
        shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(target.GetPrim()))
        parts = shapes.ComputeSubShapeWeights(weights)
        if parts:
            indices, offsets = shapes.ComputeBlendShapePointIndices(), shapes.ComputeSubShapePointOffsets()
            shapes.ComputeDeformedPoints(*parts, indices, offsets, points)

    def normals(self, mesh, target, joints, point_count):
        """Authored normals, turned as the points are."""
        normals, interpolation = mesh.GetNormalsAttr().Get(self.time), mesh.GetNormalsInterpolation()
        primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
        if primvar and primvar.HasValue():
            normals, interpolation = primvar.ComputeFlattened(self.time), primvar.GetInterpolation()
        if not normals or interpolation not in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.faceVarying):
            return None
        indices, weights = target.ComputeVaryingJointInfluences(point_count, self.time)
        count = len(weights) // point_count
        if interpolation == UsdGeom.Tokens.faceVarying:
            corners = mesh.GetFaceVertexIndicesAttr().Get(self.time)
            places = [corner * count + i for corner in corners for i in range(count)]
            indices, weights = ([values[place] for place in places] for values in (indices, weights))
        if len(normals) * count != len(weights):
            return None
        mapper = target.GetJointMapper()
        if mapper:
            joints = mapper.RemapTransforms(joints)
        turns = [inverse_transpose(joint) for joint in joints]
        bind = inverse_transpose(target.GetGeomBindTransform(self.time))
        normals = Vt.Vec3fArray(normals)
        done = UsdSkel.SkinNormals(
            target.GetSkinningMethod(), bind, Vt.Matrix3dArray(turns), Vt.IntArray(indices), Vt.FloatArray(weights), count, normals
        )
        return (str(interpolation), normals) if done else None


def inverse_transpose(matrix):
    """The map of normals."""
    linear = matrix.ExtractRotationMatrix()
    return linear.GetInverse().GetTranspose() if abs(linear.GetDeterminant()) > 1e-30 else Gf.Matrix3d(1)
